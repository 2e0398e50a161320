// A stand-in of what Flamenco's Manager gives its job compilers, from its documented behaviour: `author`, `path`,
// `print` and `frameChunker`. Tasks and commands are plain objects, so that they can be read as JSON.

var printed = [];

function print() {
    printed.push(Array.prototype.slice.call(arguments).join(" "));
}

function Task(name, type) {
    if (!String(name).trim() || !String(type).trim()) {
        throw "author.Task(name, type): both are required";
    }
    this.name = String(name).trim();
    this.type = String(type).trim();
    this.commands = [];
    this.dependencies = [];
}
Task.prototype.addCommand = function (command) { this.commands.push(command); };
Task.prototype.addDependency = function (task) { this.dependencies.push(task); };

var author = {
    Task: function (name, type) { return new Task(name, type); },
    Command: function (name, parameters) { return { name: name, parameters: parameters }; }
};

// Understands the separators of both systems, wherever the Manager runs.
var path = {
    dirname: function (file) { return file.replace(/[\/\\][^\/\\]*$/, "") || "/"; },
    basename: function (file) { return file.replace(/^.*[\/\\]/, ""); },
    stem: function (file) { return path.basename(file).replace(/\.[^.]*$/, ""); },
    join: function () {
        return Array.prototype.slice.call(arguments).join("/").replace(/\/+/g, "/");
    }
};

// Ranges of frames that are not negative, in chunks; runs of three and more are written as ranges.
function frameChunker(text, size) {
    var numbers = {};
    text.replace(/\.\./g, "-").split(",").forEach(function (part) {
        var ends = part.split("-");
        for (var frame = parseInt(ends[0], 10); frame <= parseInt(ends[ends.length - 1], 10); frame++) {
            numbers[frame] = true;
        }
    });
    var frames = Object.keys(numbers).map(Number).sort(function (a, b) { return a - b; });
    var chunks = [];
    for (var start = 0; start < frames.length; start += size) {
        var runs = [];
        frames.slice(start, start + size).forEach(function (frame) {
            var run = runs[runs.length - 1];
            if (run && run[run.length - 1] === frame - 1) { run.push(frame); } else { runs.push([frame]); }
        });
        chunks.push(runs.map(function (run) {
            return run.length > 2 ? run[0] + "-" + run[run.length - 1] : run.join(",");
        }).join(","));
    }
    return chunks;
}

// The job as the Manager stores it: tasks by their place, dependencies as places of tasks that were added before.
function compiled(settings) {
    var job = { settings: settings, tasks: [], addTask: function (task) { this.tasks.push(task); } };
    compileJob(job);
    return job.tasks.map(function (task) {
        return {
            name: task.name, type: task.type, commands: task.commands,
            dependencies: task.dependencies.map(function (earlier) { return job.tasks.indexOf(earlier); })
        };
    });
}
