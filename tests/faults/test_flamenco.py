"""The Flamenco job type: what it compiles to, and frames that its commands really bake."""

from __future__ import annotations

import io
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from farm_scene import CHONA, ENVIRONMENT, ROOT, assert_same_frames, baked, numbers, write_scene

pytest.importorskip("dukpy", reason="the engine in which the job type runs; pip install dukpy")
from flamenco_worker import Manager, Refused, command_line, find_ffmpeg, in_order, run_task
from PIL import Image

from chona_model.formats.exr import read_frame

SCENE = {
    "frames": "1-5", "chunk_size": 2, "model": "/farm/model.safetensors", "output": "/farm/frames", "name": "walk",
    "fps": 24, "blendfile": "/farm/walk.blend", "render_output_path": "/farm/frames/composited/######",
}  # fmt: skip
VARIABLES = {"chona": "/opt/chona", "blender": "/opt/blender", "blenderArgs": "-b -y"}


@pytest.fixture(scope="module")
def manager() -> Manager:
    return Manager()


@pytest.fixture
def settings(manager: Manager) -> dict:
    """As the submit panel sends them."""
    return manager.defaults() | SCENE


def launcher(folder: Path) -> str:
    """A program ``chona`` of this source tree, as a studio's variable names it."""
    program = folder / "chona"
    program.write_text(f'#!/bin/sh\nexec {shlex.join(CHONA)} "$@"\n')
    program.chmod(0o755)
    return str(program)


def test_settings_are_what_the_submit_panel_understands(manager: Manager) -> None:
    """Types, places and defaults that Flamenco's add-on can make a property of; expressions are Python."""
    assert manager.job_type["label"] == "CHONA Bake"
    for setting in manager.job_type["settings"]:
        kind = {"string": str, "int32": int, "float": (int, float), "bool": bool}[setting["type"]]
        assert isinstance(setting.get("default", kind() if isinstance(kind, type) else 0), kind), setting
        assert setting.get("visible", "visible") in {"visible", "hidden", "submission", "web"}
        assert setting.get("subtype", "file_path") in {"file_path", "dir_path", "hashed_file_path"}
        assert setting.get("default", "auto") in setting.get("choices", [setting.get("default", "auto")])
        assert setting.get("description", "") or setting["visible"] == "hidden"
        compile(setting.get("eval", "0"), setting["key"], "eval")


def test_it_keeps_to_what_every_manager_understands() -> None:
    """ECMAScript 5.1: no declarations, functions or texts of later editions."""
    script = (ROOT / "chona_model/farm/chona_bake.js").read_text("utf-8")
    code = re.sub(r'"(?:[^"\\\n]|\\.)*"|//[^\n]*', '""', script)
    assert not re.search(r"=>|`|\.\.\.|\b(let|const|class|of|async|yield|import|export)\b", code)


def test_expressions_take_the_scenes_settings(manager: Manager) -> None:
    """And give empty text where our add-on is not there, instead of an error in the panel."""
    expressions = {each["key"]: each["eval"] for each in manager.job_type["settings"] if "eval" in each}

    class Passes:
        def names(self) -> tuple[str, ...]:
            return ("combined", "depth")

    class Of:
        def __init__(self, **values: object) -> None:
            self.__dict__.update(values)

    render = Of(fps=24, fps_base=1.001)
    chona = Of(model_path="//m.safetensors", output_folder="//frames", name="walk", passes=Passes())
    names = {"abspath": lambda path: Path("/farm", path.lstrip("/")), "Path": Path, "settings": Of(output="//frames")}

    def found(scene: object) -> dict:
        return {key: eval(text, {}, names | {"C": Of(scene=scene)}) for key, text in expressions.items()}

    there = found(Of(frame_start=1, frame_end=9, render=render, chona=chona))
    assert there == {
        "frames": "1-9", "model": "/farm/m.safetensors", "output": "/farm/frames", "name": "walk",
        "passes": "combined,depth", "fps": 24 / 1.001, "render_output_path": "/farm/frames/composited/######",
    }  # fmt: skip
    absent = found(Of(frame_start=1, frame_end=9, render=render))
    assert [absent[key] for key in ("model", "output", "name", "passes")] == [""] * 4


def test_the_whole_job(manager: Manager, settings: dict) -> None:
    """Shot, bakes, composite, renders, video: each waits for all of what comes before."""
    tasks = list(in_order(manager.compile(settings)))
    assert [task["name"] for task in tasks] == [
        "shot", "bake-1-2", "bake-3-4", "bake-5", "composite", "render-1-2", "render-3-4", "render-5", "preview-video",
    ]  # fmt: skip
    assert [task["dependencies"] for task in tasks] == [
        [], [0], [0], [0], [1, 2, 3], [4], [4], [4], [5, 6, 7],
    ]  # fmt: skip
    assert [task["type"] for task in tasks] == ["blender"] * 8 + ["ffmpeg"]
    lines = [shlex.join(command_line(task["commands"][0], VARIABLES)) for task in tasks]
    assert lines[0] == (
        "/opt/blender -b -y /farm/walk.blend --command chona shot --out /farm/frames --name walk --frames=1-5"
    )
    assert lines[2] == (
        "/opt/chona bake --model /farm/model.safetensors --shot /farm/frames/walk.shot.npz --out /farm/frames "
        "--frames=3-4 --preset final --share 120 --progress json --device auto"
    )
    assert lines[4] == (
        "/opt/blender -b -y /farm/walk.blend --command chona composite --out /farm/frames --name walk "
        "--save /farm/walk.composited.blend"
    )
    assert lines[6] == (
        "/opt/blender -b -y /farm/walk.composited.blend --render-output '/farm/frames/composited/######' "
        "--render-format PNG --render-frame 3..4"
    )
    assert lines[8].startswith("ffmpeg -r 24 -pattern_type glob -i '/farm/frames/composited/*.png' -c:v h264")
    assert lines[8].endswith("-y -r 24 /farm/frames/composited/walk-1-5.mp4")


def test_every_option_is_one_that_the_command_has(manager: Manager, settings: dict) -> None:
    from chona_model.cli import COMMANDS
    from chona_model.command_line import make_parser

    more = {"preset": "exact", "passes": "combined,depth", "max_error": 0.01, "device": "cpu", "existing": "keep",
            "patience": 30, "shot": "/farm/a.shot.npz", "frames": "-7--3"}  # fmt: skip
    (bake,) = manager.compile(settings | more | {"composite": False, "video": False, "chunk_size": 9})
    words = command_line(bake["commands"][0], VARIABLES)
    given = make_parser(COMMANDS).parse_args(words[1:])
    assert given.frames == (-7, -6, -5, -4, -3) and given.preset == "exact" and given.passes == ("combined", "depth")
    assert (given.max_error, given.device, given.only_missing, given.share) == (0.01, "cpu", True, 30.0)
    assert given.shot == Path("/farm/a.shot.npz") and given.progress == "json"


@pytest.mark.parametrize("size", [1, 2, 3, 50])
@pytest.mark.parametrize("frames", ["1-10", "47", "3, 5-10, 47-49", "1..4,2-6", "9,1,5"])
def test_chunks_are_the_managers_own(manager: Manager, frames: str, size: int) -> None:
    """The same frames in the same chunks, however a pair of neighbours is written."""
    from chona_model.arguments import frame_list

    ours, theirs = (manager.chunks(frames, size, ours) for ours in (True, False))
    assert [frame_list(chunk) for chunk in ours] == [frame_list(chunk) for chunk in theirs]


def test_negative_frames_are_baked(manager: Manager) -> None:
    assert manager.chunks("-3-1, -7..-6", 3, True) == ["-7--6,-3", "-2-0", "1"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frames": "1 10"}, "frames '1 10': '1 10' is not a frame or a range; write for example 1-50,60"),
        ({"frames": "9-1"}, "frames '9-1': the range '9-1' is empty; write the smaller number first"),
        ({"frames": ""}, "frames '': '' is not a frame or a range; write for example 1-50,60"),
        ({"frames": "0-2000000"}, "frames '0-2000000' are more than 1000000; submit them as several jobs"),
        ({"frames": "-2-2"}, "frame -2 is to be composited, but Blender's command line takes no negative frames; "
                             "switch Composite off, or move the scene to positive frames"),
        ({"model": ""}, "the setting 'model' is empty; it is needed to bake"),
        ({"name": "a/b"}, "the setting 'name' is 'a/b', which is a path; expected a name: put folders into 'output'"),
        ({"chunk_size": 0}, "the setting 'chunk_size' is 0, expected a whole number of at least 1"),
    ],
)  # fmt: skip
def test_what_cannot_be_baked_is_refused_at_submission(
    manager: Manager, settings: dict, changes: dict, words: str
) -> None:
    with pytest.raises(Refused) as caught:
        manager.compile(settings | changes)
    assert str(caught.value) == words


def test_a_composite_that_is_no_video_makes_none(manager: Manager, settings: dict) -> None:
    names = [task["name"] for task in manager.compile(settings | {"format": "OPEN_EXR", "frames": "1"})]
    assert names == ["shot", "bake-1", "composite", "render-1"]


@pytest.mark.slow
def test_its_commands_bake_what_one_bake_would(manager: Manager, settings: dict, tmp_path: Path) -> None:
    """Names with spaces and signs that shells, globs and formats read; a frame that is there is left alone."""
    folder = tmp_path / "sc 01 'a' $HOME [x]*"
    model, shot = write_scene(folder, 5, first=-2, name="roll & pan")
    truth = baked(model, shot, tmp_path / "truth")
    out = folder / "out"
    job = settings | {
        "frames": "-2-2", "model": str(model), "shot": str(shot), "output": str(out), "name": "roll & pan",
        "preset": "draft", "device": "cpu", "composite": False, "chunk_size": 3,
    }  # fmt: skip
    *bakes, video = in_order(manager.compile(job))
    assert [task["name"] for task in bakes] == ["bake--2-0", "bake-1-2"]
    variables = {"chona": launcher(tmp_path), "ffmpeg": find_ffmpeg() or ""}
    for task in bakes:
        run_task(task, variables)
    assert_same_frames(out, truth)
    before = {name: (out / name).stat().st_mtime_ns for name in numbers(out)}
    run_task(bakes[0], variables)  # as when a Manager gives a task out once more
    assert {name: (out / name).stat().st_mtime_ns for name in numbers(out)} == before
    if not variables["ffmpeg"]:
        pytest.skip("no ffmpeg: the frames are baked, the video is not made")
    run_task(video, variables)
    (film,) = out.glob("*.mp4")
    assert film.name == "roll & pan--2-2.mp4"
    layers, _ = read_frame(truth / "roll & pan_-0001.exr")  # patterns put it before -0002
    light = np.clip(layers.combined[..., :3], 0.0, 1.0)
    shown = 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    picture = first_picture(variables["ffmpeg"], film)
    assert picture.shape == (32, 48) and np.abs(picture - shown @ [0.299, 0.587, 0.114]).mean() < 2.0
    assert picture.max() > 60.0


def first_picture(ffmpeg: str, film: Path) -> np.ndarray:
    """[H, W] grey values of a video's first picture, 0 to 255."""
    command = [ffmpeg, "-i", film, "-frames:v", "1", "-f", "image2pipe", "-vcodec", "pgm", "-"]
    found = subprocess.run(list(map(str, command)), capture_output=True, check=True).stdout
    return np.asarray(Image.open(io.BytesIO(found)), dtype=float)


def test_chona_farm_writes_it_where_the_manager_looks(tmp_path: Path) -> None:
    scripts = tmp_path / "flamenco 3" / "scripts"
    command = [*CHONA, "farm", "flamenco", "--out", str(scripts)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stdout == f"{scripts / 'chona_bake.js'}\n"
    assert (scripts / "chona_bake.js").read_bytes() == (ROOT / "chona_model/farm/chona_bake.js").read_bytes()


def test_the_extension_and_the_package_carry_it() -> None:
    """So a studio that has one of them has the job type."""
    sys.path.insert(0, str(ROOT / "scripts"))
    import tomllib

    from build_extension import collect

    assert {"worker/chona_model/farm/chona_bake.js", "worker/chona_model/farm/chona_bake.sbatch"} <= set(collect(ROOT))
    data = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    assert data["chona_model.farm"] == ["chona_bake.js", "chona_bake.sbatch"]


def test_the_globals_are_enough_for_flamencos_own_documentation_example() -> None:
    """The stand-in is no special case of our script: a job type as simple as can be compiles in it."""
    import dukpy

    engine = dukpy.JSInterpreter()
    script = """
        function compileJob(job) {
            var task = author.Task("wait", "misc");
            task.addCommand(author.Command("sleep", { duration_in_seconds: job.settings.seconds }));
            job.addTask(task);
        }
        JSON.stringify(compiled({ seconds: 3 }));
    """
    tasks = json.loads(engine.evaljs([(Path(__file__).with_name("flamenco_globals.js")).read_text(), script]))
    assert tasks == [
        {"name": "wait", "type": "misc", "dependencies": [],
         "commands": [{"name": "sleep", "parameters": {"duration_in_seconds": 3}}]}
    ]  # fmt: skip
