// SPDX-License-Identifier: GPL-3.0-or-later
//
// A job type for Flamenco 3.3 and newer: bakes a shot in chunks of frames, composites them with Blender, renders the
// composite and makes a preview video. `chona farm flamenco --out FOLDER/scripts` puts it where the Manager looks; the
// variable {chona} in flamenco-manager.yaml is the path of the command chona on the workers (docs/farm.md).
// ECMAScript 5.1, which every version of the Manager understands.

var JOB_TYPE = {
    label: "CHONA Bake",
    description: "Bake people and objects of a CHONA model to EXR, composite them, and make a preview video",
    settings: [
        { key: "frames", type: "string", required: true,
          eval: "f'{C.scene.frame_start}-{C.scene.frame_end}'",
          evalInfo: { showLinkButton: true, description: "Scene frame range" },
          description: "Frames to bake. Examples: '47', '1-30', '-5-12, 20-30'" },
        { key: "chunk_size", type: "int32", default: 20, propargs: { min: 1, max: 10000 }, visible: "submission",
          description: "Frames of one task; each task loads the model once" },

        { key: "model", type: "string", subtype: "file_path", required: true,
          eval: "str(abspath(C.scene.chona.model_path)) if hasattr(C.scene, 'chona') else ''",
          description: "Model file (.safetensors) of the first actor, where workers find it" },
        { key: "output", type: "string", subtype: "dir_path", required: true,
          eval: "str(abspath(C.scene.chona.output_folder)) if hasattr(C.scene, 'chona') else ''",
          description: "Folder of the baked frames, on storage that all workers share" },
        { key: "name", type: "string", required: true,
          eval: "C.scene.chona.name if hasattr(C.scene, 'chona') else ''",
          description: "Name of the bake; frames are NAME_0001.exr and so on" },
        { key: "shot", type: "string", subtype: "file_path", visible: "submission",
          description: "Shot to bake (NAME.shot.npz). Empty: it is made from the blend file, beside the frames" },

        { key: "preset", type: "string", default: "final",
          description: "Speed and accuracy: draft, preview, final, exact, or one of your own that the workers have" },
        { key: "passes", type: "string",
          eval: "','.join(C.scene.chona.passes.names()) if hasattr(C.scene, 'chona') else ''",
          description: "Passes of the frames, such as 'combined,depth,mattes'. Empty: the usual ones" },
        { key: "max_error", type: "float", default: 0, propargs: { min: 0, max: 0.5 },
          description: "Pixels are rendered finer until they change by no more. 0: off" },
        { key: "device", type: "string", choices: ["auto", "cpu", "cuda"], default: "auto",
          description: "What the workers compute on" },
        { key: "existing", type: "string", choices: ["update", "keep"], default: "update", visible: "submission",
          description: "Frames that are there: bake those that are out of date again, or leave all whole ones" },
        { key: "patience", type: "int32", default: 120, propargs: { min: 10, max: 86400 }, visible: "submission",
          description: "Seconds without a sign of life after which a frame that a worker had begun is another's" },

        { key: "composite", type: "bool", default: true,
          description: "Composite the frames with the blend file's scene, and render that" },
        { key: "render_output_path", type: "string", subtype: "file_path", editable: false,
          eval: "str(Path(abspath(settings.output), 'composited', '######'))",
          description: "Where the rendered composite is saved" },
        { key: "format", type: "string", choices: ["PNG", "JPEG", "OPEN_EXR", "OPEN_EXR_MULTILAYER"], default: "PNG",
          description: "Of the rendered composite" },
        { key: "video", type: "bool", default: true,
          description: "Make a preview video of the composite, or of the baked frames where there is none" },

        { key: "fps", type: "float", eval: "C.scene.render.fps / C.scene.render.fps_base", visible: "hidden" },
        { key: "blendfile", type: "string", required: true, visible: "web", description: "Path of the blend file" }
    ]
};

// Composites in these become a video.
var VIDEO_SUFFIXES = { PNG: ".png", JPEG: ".jpg" };
var LAYER = "CHONA.Combined";
// Baked frames are scene-linear; videos are sRGB. Filters that FFmpeg 4 has as well as later ones.
var ENCODED = "'maxval*if(lte(val/maxval,0.0031308),12.92*val/maxval,1.055*pow(val/maxval,1/2.4)-0.055)'";
var SRGB = "format=gbrp16,lutrgb=r=" + ENCODED + ":g=" + ENCODED + ":b=" + ENCODED +
    ",setparams=color_trc=iec61966-2-1,";
var EVEN = "pad=ceil(iw/2)*2:ceil(ih/2)*2";
var LARGEST_JOB = 1000000;

function compileJob(job) {
    var settings = job.settings;
    check(settings);
    var numbers = frameNumbers(settings.frames);
    var chunks = chunksOf(numbers, settings.chunk_size);
    if (settings.composite && numbers[0] < 0) {
        throw "frame " + numbers[0] + " is to be composited, but Blender's command line takes no negative frames; " +
            "switch Composite off, or move the scene to positive frames";
    }

    var first = [];
    var shot = settings.shot;
    if (!shot) {
        shot = path.join(settings.output, settings.name + ".shot.npz");
        first.push(blenderTask("shot", settings, settings.blendfile, [
            "--command", "chona", "shot", "--out", settings.output, "--name", settings.name,
            "--frames=" + range(numbers[0], numbers[numbers.length - 1])
        ]));
    }
    var bakes = chunks.map(function (chunk) {
        return bakeTask(settings, shot, chunk);
    });
    addAfter(job, first, []);
    addAfter(job, bakes, first);

    var last = bakes;
    if (settings.composite) {
        last = addComposite(job, settings, chunks, bakes);
    }
    addVideo(job, settings, last, numbers);
}

function check(settings) {
    ["model", "output", "name", "blendfile"].forEach(function (key) {
        if (!settings[key]) {
            throw "the setting '" + key + "' is empty; it is needed to bake";
        }
    });
    if (/[\/\\]/.test(settings.name)) {
        throw "the setting 'name' is '" + settings.name + "', which is a path; expected a name: put folders into 'output'";
    }
    if (!(settings.chunk_size >= 1)) {
        throw "the setting 'chunk_size' is " + settings.chunk_size + ", expected a whole number of at least 1";
    }
}

// Tasks are added to the job; each waits for all of `before`.
function addAfter(job, tasks, before) {
    tasks.forEach(function (task) {
        before.forEach(function (earlier) {
            task.addDependency(earlier);
        });
        job.addTask(task);
    });
}

function bakeTask(settings, shot, chunk) {
    var args = [
        "bake", "--model", settings.model, "--shot", shot, "--out", settings.output, "--frames=" + chunk,
        "--preset", settings.preset || "final", "--share", String(settings.patience || 120), "--progress", "json"
    ];
    if (settings.device) {
        args.push("--device", settings.device);
    }
    if (settings.passes) {
        args.push("--passes", settings.passes);
    }
    if (settings.max_error > 0) {
        args.push("--max-error", String(settings.max_error));
    }
    if (settings.existing === "keep") {
        args.push("--only-missing");
    }
    var task = author.Task("bake-" + chunk, "blender");
    task.addCommand(author.Command("exec", { exe: "{chona}", args: args }));
    return task;
}

function blenderTask(name, settings, blendfile, args) {
    var task = author.Task(name, "blender");
    task.addCommand(author.Command("blender-render", {
        exe: "{blender}", exeArgs: "{blenderArgs}", argsBefore: [], blendfile: blendfile, args: args
    }));
    return task;
}

// The scene with the frames in its compositor is a file of its own, beside the blend file: the artist's stays as it is.
function addComposite(job, settings, chunks, bakes) {
    var blendfile = settings.blendfile;
    var composited = path.join(path.dirname(blendfile), path.stem(blendfile) + ".composited.blend");
    var composite = blenderTask("composite", settings, blendfile, [
        "--command", "chona", "composite", "--out", settings.output, "--name", settings.name, "--save", composited
    ]);
    var renders = chunks.map(function (chunk) {
        return blenderTask("render-" + chunk, settings, composited, [
            "--render-output", settings.render_output_path, "--render-format", settings.format,
            "--render-frame", chunk.replace(/-/g, "..")
        ]);
    });
    addAfter(job, [composite], bakes);
    addAfter(job, renders, [composite]);
    return renders;
}

function addVideo(job, settings, last, numbers) {
    var suffix = VIDEO_SUFFIXES[settings.format];
    if (!settings.video || !settings.fps || (settings.composite && !suffix)) {
        print("CHONA Bake: no preview video");
        return;
    }
    var folder = settings.composite ? path.dirname(settings.render_output_path) : settings.output;
    var files = settings.composite ? "*" + suffix : literal(settings.name) + "_*.exr";
    var span = range(numbers[0], numbers[numbers.length - 1]);
    var task = author.Task("preview-video", "ffmpeg");
    task.addCommand(author.Command("frames-to-video", {
        exe: "ffmpeg",
        fps: settings.fps,
        inputGlob: path.join(literal(folder), files),
        outputFile: path.join(folder, settings.name + "-" + span + ".mp4"),
        argsBefore: settings.composite ? [] : ["-layer", LAYER],
        args: [
            "-c:v", "h264", "-crf", "20", "-g", "18", "-vf", (settings.composite ? "" : SRGB) + EVEN,
            "-pix_fmt", "yuv420p", "-y"
        ]
    }));
    addAfter(job, [task], last);
}

// A name as a pattern that stands for itself alone.
function literal(name) {
    return name.replace(/[\[*?]/g, "[$&]");
}

function range(first, last) {
    return first === last ? String(first) : first + "-" + last;
}

// "1-3, 7, -5..-4" -> [-5, -4, 1, 2, 3, 7]. The Manager's frameChunker takes no negative frames, which shots have.
function frameNumbers(text) {
    var seen = {};
    var numbers = [];
    String(text).split(",").forEach(function (part) {
        var match = /^\s*(-?\d+)\s*(?:(?:-|\.\.)\s*(-?\d+)\s*)?$/.exec(part);
        if (!match) {
            throw "frames '" + text + "': '" + part + "' is not a frame or a range; write for example 1-50,60";
        }
        var first = Number(match[1]);
        var last = match[2] === undefined || match[2] === "" ? first : Number(match[2]);
        if (last < first) {
            throw "frames '" + text + "': the range '" + part + "' is empty; write the smaller number first";
        }
        if (last - first >= LARGEST_JOB - numbers.length) {
            throw "frames '" + text + "' are more than " + LARGEST_JOB + "; submit them as several jobs";
        }
        for (var frame = first; frame <= last; frame++) {
            if (!seen[frame]) {
                seen[frame] = true;
                numbers.push(frame);
            }
        }
    });
    return numbers.sort(function (a, b) { return a - b; });
}

// [1, 2, 3, 7], 3 -> ["1-3", "7"]
function chunksOf(numbers, size) {
    var chunks = [];
    for (var start = 0; start < numbers.length; start += size) {
        chunks.push(merged(numbers.slice(start, start + size)));
    }
    return chunks;
}

// [1, 2, 3, 7] -> "1-3,7"
function merged(numbers) {
    var parts = [];
    var first = numbers[0];
    numbers.forEach(function (number, index) {
        if (numbers[index + 1] !== number + 1) {
            parts.push(range(first, number));
            first = numbers[index + 1];
        }
    });
    return parts.join(",");
}
