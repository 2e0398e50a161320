"""Where a bake writes: the settings' folder and name, or such beside the scene's own output."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import bpy

from .errors import ChonaError
from .frames import frame_file_name

_NUMBER = 88888888
"""A frame that is found again in a path, whatever stands around it."""


@dataclass(frozen=True)
class Output:
    """The folder of a bake's frames, absolute, and what their files' names begin with."""

    folder: Path
    name: str

    def frame(self, number: int) -> Path:
        """The file of one frame."""
        return self.folder / frame_file_name(self.name, number)


def absolute(path: str) -> Path:
    """A path as the user wrote it -> absolute. `//` in a file that was never saved is in the temporary folder."""
    if path.startswith("//") and not bpy.data.filepath:
        return Path(tempfile.gettempdir()) / "chona_unsaved" / path[2:]
    return Path(bpy.path.abspath(path)).absolute()


def goes_to_temporary(scene: bpy.types.Scene) -> bool:
    """Whether frames go to a temporary folder, because their path is relative to a file that was never saved."""
    settings = scene.chona
    given = scene.render.filepath if settings.use_scene_output else settings.output_folder
    return given.startswith("//") and not bpy.data.filepath


def bake_output(scene: bpy.types.Scene) -> Output:
    """Where the scene's bake goes.

    Raises:
        ChonaError: no folder is set, or the name cannot be part of a file's.
    """
    settings = scene.chona
    if settings.use_scene_output:
        output = _beside_render(scene)
        return Output(output.folder, _checked(output.name))
    if not settings.output_folder.strip():
        raise ChonaError("no output folder is set; choose a folder")
    return Output(absolute(settings.output_folder), _checked(settings.name.strip()))


def output_now(scene: bpy.types.Scene) -> Output | None:
    """As `bake_output`, for panels; None where it would be refused."""
    try:
        return bake_output(scene)
    except ChonaError:
        return None


def _beside_render(scene: bpy.types.Scene) -> Output:
    """`//render/walk_####.png` -> the folder `//render/walk_chona`, the name `walk`: never the render's own files."""
    render = scene.render
    if render.filepath.startswith("//") and not bpy.data.filepath:
        written = absolute(render.filepath.replace("#", ""))
        if render.filepath.endswith(("/", "\\")):
            written = written / str(_NUMBER)
    else:
        try:
            written = Path(render.frame_path(frame=_NUMBER)).absolute()
        except (RuntimeError, ValueError) as error:  # a template that Blender cannot fill in
            raise ChonaError(f"the scene's output {render.filepath!r} is not a path ({error}); correct it") from error
    name = written.stem.replace(str(_NUMBER), "").strip("_-. ")
    folder = f"{name}_chona" if name else "chona"
    return Output(written.parent / folder, name or scene.chona.name.strip())


def _checked(name: str) -> str:
    if not name or name.startswith(".") or any(character in name for character in '/\\:*?"<>|#'):
        raise ChonaError(f"the name {name!r} cannot be part of a file name; write letters, digits, - and _")
    return name
