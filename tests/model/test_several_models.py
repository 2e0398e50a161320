"""Shots whose actors are of several models, against each model alone and both merged by hand."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
import torch
from scene_files import grid_file, moved, without_objects, write_poses

from chona_model.adaptive import ladder
from chona_model.bake import bake
from chona_model.bake_report import BakeReport
from chona_model.cli import main
from chona_model.formats.exr import read_frame
from chona_model.formats.model_file import ModelFileError, file_hash
from chona_model.formats.shot import Shot, ShotError, read_shot, write_shot
from chona_model.frame import ShotRenderer, linear_from_srgb, render_frame
from chona_model.grid_actor import GridActor
from chona_model.model_store import load_actor, save_actor
from chona_model.progress import Progress
from chona_model.samples import beside_each_other, composite, over_each_other
from chona_model.settings import RENDER_PRESETS, RenderSettings
from chona_model.shot_models import find_models

DRAFT = RENDER_PRESETS["draft"]


@cache
def second_file() -> Path:
    """A model of Sub02 and box03 alone, in other colours than ``grid_file``'s."""
    actor = load_actor(grid_file()[0], persons=["Sub02"], objects=["box03"])
    assert isinstance(actor, GridActor)
    with torch.no_grad():
        actor.model.field.person_codes += 0.5
        actor.model.field.light.normal_(std=0.5, generator=torch.manual_seed(1))
    path = Path(mkdtemp()) / "second.safetensors"
    save_actor(path, actor, "chona", {}, {})
    return path


def scene(folder: Path, model: str | None = None) -> Path:
    """A shot: Sub01 with box01 of the model it is baked with, and before them Sub02 of ``model`` (``second_file``)."""
    view, other = grid_file()[1].views[0], grid_file()[1].views[2]
    nearer = without_objects(replace(other.pose, world_from_bone=moved(
        other.pose.world_from_bone, view.camera, (0.1, 0.1, 2.0)
    )))  # fmt: skip
    path = write_poses(folder / "two.shot.npz", view.camera, [view.pose], [nearer])
    content = read_shot(path)
    first, second = content.actors
    write_shot(path, replace(content, actors=(first, replace(second, model=model or str(second_file())))))
    return path


def loaded(shot: Shot) -> tuple[GridActor, GridActor]:
    actors = find_models(shot, grid_file()[0], None).load(shot, "cpu").actors
    assert isinstance(actors[0], GridActor) and isinstance(actors[1], GridActor)
    return actors[0], actors[1]


def run(folder: Path, shot: Path, **options: object) -> BakeReport:
    progress = Progress("json", output=io.StringIO())
    return bake(grid_file()[0], shot, folder / "out", None, "draft", False, progress, **options)  # type: ignore[arg-type]


def test_every_actor_is_drawn_by_its_own_model(tmp_path: Path) -> None:
    """Where one shows it is that model's picture to the bit; where both do, their samples in order of depth."""
    shot = read_shot(scene(tmp_path))
    actors, camera = loaded(shot), shot.camera(0)
    settings = replace(DRAFT, resolution=1.0)
    frame = ShotRenderer(actors, shot, settings).render(0)
    poses = [member.pose(0) for member in shot.actors]
    alone = [actor.render(pose, camera, settings) for actor, pose in zip(actors, poses, strict=True)]
    both = over_each_other(alone)
    assert both.sum() > 20 and all(((one.alpha > 0.5) & ~both).sum() > 20 for one in alone)
    for one in alone:
        here = (one.alpha > 0) & ~both
        straight = np.clip(one.rgb[here] / one.alpha[here, None], 0, 1)
        np.testing.assert_array_equal(frame.combined[here, :3], linear_from_srgb(straight) * one.alpha[here, None])
    samples = [actor.sample(pose, camera, settings, both) for actor, pose in zip(actors, poses, strict=True)]
    merged = composite(samples, camera, 1, beside_each_other(alone), both)
    np.testing.assert_allclose(frame.combined[both, 3], merged.alpha[both], atol=1e-6)
    wrong = render_frame(load_actor(grid_file()[0]), shot, 0, settings)
    assert np.abs(wrong.combined - frame.combined).max() > 0.05, "the second model must look different"


def test_of_every_model_only_its_own_actors_are_loaded(tmp_path: Path) -> None:
    shot = read_shot(scene(tmp_path))
    first, second = loaded(shot)
    assert (list(first.persons), list(first.objects)) == (["Sub01"], ["box01"])
    assert (list(second.persons), list(second.objects)) == (["Sub02"], [])
    assert run(tmp_path, tmp_path / "two.shot.npz").left_out.identities == ("Sub02", "box02", "box03", "box03")


def test_a_frame_is_rendered_again_when_any_of_its_models_changes(tmp_path: Path) -> None:
    """The second model lies beside the shot and is named by its file name."""
    second = Path(shutil.copy(second_file(), tmp_path / "second.safetensors"))
    shot, frame = scene(tmp_path, "second.safetensors"), tmp_path / "out" / "walk_0001.exr"
    assert (run(tmp_path, shot).written, run(tmp_path, shot).skipped) == (1, 1)
    before, header = read_frame(frame)
    assert header.model not in (file_hash(grid_file()[0]), file_hash(second))
    actor = load_actor(second)
    with torch.no_grad():
        actor.model.field.light.mul_(-1.0)  # type: ignore[attr-defined]
    save_actor(second, actor, "chona", {}, {})
    assert run(tmp_path, shot).written == 1
    assert np.abs(read_frame(frame)[0].combined - before.combined).max() > 0.02


def test_naming_the_same_model_is_naming_none(tmp_path: Path) -> None:
    """No second copy in memory, and the frame's own hash of the model."""
    shot = read_shot(scene(tmp_path, str(grid_file()[0])))
    models = find_models(shot, grid_file()[0], None)
    actors = models.load(shot, "cpu").actors
    assert actors[0] is actors[1]
    assert models.digest() == file_hash(grid_file()[0])


@pytest.mark.parametrize(
    ("model", "kind", "words"),
    [
        ("gone.safetensors", ShotError, "actor 'Sub02' is of the model 'gone.safetensors', and there is no file"),
        ("/etc/passwd", ShotError, "actor 'Sub02' is of the model '/etc/passwd', expected a .safetensors file"),
        ("empty.safetensors", ModelFileError, "empty.safetensors is no safetensors file"),
    ],
)
def test_a_model_that_is_none_is_refused_by_the_actor(
    tmp_path: Path, model: str, kind: type[Exception], words: str
) -> None:
    (tmp_path / "empty.safetensors").touch()
    with pytest.raises(kind, match=words):
        run(tmp_path, scene(tmp_path, model))


def test_what_a_model_lacks_is_said_of_its_own_actor(tmp_path: Path) -> None:
    """Sub01 is in the first model, but the actor that wants it is of the second."""
    path = scene(tmp_path)
    shot = read_shot(path)
    write_shot(path, replace(shot, actors=(shot.actors[0], replace(shot.actors[1], person="Sub01"))))
    with pytest.raises(ShotError, match="actor 'Sub02' wants the person 'Sub01', the model has Sub02"):
        run(tmp_path, path)


def bounded(shot: Shot, settings: RenderSettings, bound: float) -> tuple[np.ndarray, ShotRenderer]:
    renderer = ShotRenderer(loaded(shot), shot, settings, max_error=bound)
    return renderer.render(0).combined, renderer


def test_a_bound_holds_where_actors_overlap(tmp_path: Path) -> None:
    """Alpha, which is not made linear, of the whole picture against the finest settings of all."""
    shot = read_shot(scene(tmp_path))
    coarse, bound = replace(DRAFT, resolution=1.0, step=0.03), 0.03
    finest = ShotRenderer(loaded(shot), shot, ladder(coarse)[-1]).render(0).combined
    plain, (picture, renderer) = (
        ShotRenderer(loaded(shot), shot, coarse).render(0).combined,
        bounded(shot, coarse, bound),
    )
    poses, camera = [member.pose(0) for member in shot.actors], shot.camera(0)
    alone = [actor.render(pose, camera, coarse) for actor, pose in zip(loaded(shot), poses, strict=True)]
    both = over_each_other(alone)
    assert (np.abs(plain - finest)[both, 3] > bound).sum() > 3, "nothing to refine where both show"
    reached = renderer.reached
    assert reached is not None and (np.abs(picture - finest)[both, 3] > bound).sum() <= reached.unsettled
    assert reached.unsettled < 0.01 * reached.pixels


def test_one_worker_serves_several_models(tmp_path: Path) -> None:
    shot = scene(tmp_path).read_bytes()
    relative = scene(tmp_path, "second.safetensors").read_bytes()
    requests = b"".join(
        json.dumps({"request": number, "preset": "preview", "bytes": len(each)}).encode() + b"\n" + each
        for number, each in enumerate((shot,))
    )
    command = [sys.executable, "-m", "chona_model", "serve", "--model", str(grid_file()[0])]
    worker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert worker.stdin is not None and worker.stdout is not None
    assert json.loads(worker.stdout.readline())["event"] == "ready"
    worker.stdin.write(requests)
    worker.stdin.flush()
    event = json.loads(worker.stdout.readline())
    pixels = np.frombuffer(worker.stdout.read(event["bytes"]), "<f4").reshape(event["height"], event["width"], 5)
    content = read_shot(io.BytesIO(shot))
    expected = ShotRenderer(loaded(content), content, RENDER_PRESETS["preview"]).render(0).combined
    np.testing.assert_allclose(pixels[..., :4], expected, atol=1e-5)
    worker.stdin.write(json.dumps({"request": 2, "preset": "draft", "bytes": len(relative)}).encode() + b"\n")
    worker.stdin.write(relative)
    worker.stdin.close()
    refused = json.loads(worker.stdout.readline())
    assert (refused["event"], refused["request"]) == ("error", 2) and "expected an absolute one" in refused["message"]
    assert worker.wait(60) == 0


def test_an_estimate_counts_the_rays_of_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["estimate", "--model", str(grid_file()[0]), "--shot", str(scene(tmp_path)), "--progress", "json"]
    assert main([*words, "--preset", "draft", "--seconds", "0.05"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["event"] == "result" and result["presets"]["draft"]["seconds_per_frame"] > 0
    assert result["factor"] is None
