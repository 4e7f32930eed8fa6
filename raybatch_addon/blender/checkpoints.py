"""Checkpoints of final renders: whether there are any, and their files, beside the output."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

if TYPE_CHECKING:
    from ..core.checkpoint.checkpoint import Checkpoint  # brings in Warp, which panels do without

ENDING = ".checkpoint"


@dataclass(frozen=True)
class AskedCheckpoint:
    """The checkpoint that a script asks for, in place of the one that the scene asks for."""

    path: Path | None  # of a frame with one picture; None: no checkpoint
    interval: float = 60.0  # [s]
    sample_first: int = 0
    path_ahead: Path | None = None  # of the frame that follows


asked: AskedCheckpoint | None = None  # set by scripts


def first_sample() -> int:
    """The first sample of every pixel."""
    return asked.sample_first if asked else 0


def checkpoint_path(scene: bpy.types.Scene, layer: str, view: str = "", is_ahead: bool = False) -> Path:
    """Where the checkpoint of a view layer of the scene's frame is, of stereoscopy that of a view; `is_ahead`: of the
    frame that follows the one that Blender renders, where the scene is already.
    """
    named = (asked.path_ahead if is_ahead else asked.path) if asked else None
    if named:
        folder, stem, ending = named.parent, named.stem, named.suffix
    else:
        output = Path(bpy.path.abspath(scene.render.frame_path(frame=scene.frame_current)))
        folder, stem, ending = output.parent, output.stem, ENDING
        if scene.render.is_movie_format:
            stem += f".{scene.frame_current:04d}"
        # many scenes are rendered to the same place, where nobody chose one
        stem += f".{Path(bpy.data.filepath).stem or 'untitled'}"
    names = [layer] if sum(each.use for each in scene.view_layers) > 1 else []
    names += [view] if view else []
    return folder / (".".join([stem, *(bpy.path.clean_name(name) for name in names)]) + ending)


def checkpoint_of(
    scene: bpy.types.Scene, layer: str, view: str, report: Callable[[str], None], is_ahead: bool = False
) -> Checkpoint | None:
    """The checkpoint of a view layer that is about to be rendered, or of the frame that follows the one that Blender
    renders; None where there is to be none.
    """
    from ..core.checkpoint.checkpoint import Checkpoint

    own = getattr(scene, "raybatch_checkpoint", None)
    if asked is not None:
        if (asked.path_ahead if is_ahead else asked.path) is None:
            return None
        return Checkpoint(checkpoint_path(scene, layer, view, is_ahead), asked.interval, report=report)
    if own is None or not own.use:
        return None
    return Checkpoint(checkpoint_path(scene, layer, view), own.interval, begins_anew=True, report=report)
