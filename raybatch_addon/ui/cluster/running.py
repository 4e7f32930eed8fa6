"""The render on a cluster that was begun from this Blender: followed by a timer until it is over."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy

from ...blender.cluster.process import RenderProcess

LOOK_SECONDS = 0.5
IMAGE = "RayBatch Cluster"  # the picture's data-block


@dataclass
class ClusterJob:
    """A render that goes on, or the last one."""

    process: RenderProcess
    scene: str
    folder: Path  # of the copy and the picture, which goes with the next render
    ended: Callable[[ClusterJob], None]  # called once it is over
    error: str = ""
    is_over: bool = False


current: ClusterJob | None = None


def process_running() -> RenderProcess | None:
    """The process of the render that goes on, if there is one."""
    return None if current is None or current.is_over else current.process


def follow_job(job: ClusterJob) -> None:
    """Follow `job` from now on."""
    global current
    forget()
    current = job
    if not bpy.app.timers.is_registered(look_at_job):
        bpy.app.timers.register(look_at_job, first_interval=LOOK_SECONDS, persistent=True)


def look_at_job() -> float | None:
    """See how far it is, and show it; seconds to the next look."""
    job = current
    if job is None or job.is_over:
        return None
    if job.process.is_running:
        _show(job.process.message)
        return LOOK_SECONDS
    job.is_over, job.error = True, job.process.error
    job.ended(job)
    _show(None)
    return None


def forget() -> None:
    """End what goes on, and remove its files."""
    global current
    job, current = current, None
    if job is None:
        return
    if not job.is_over:
        job.process.kill()
    shutil.rmtree(job.folder, ignore_errors=True)


def new_folder() -> Path:
    """A folder for the files of a render, in Blender's own, which goes when Blender ends."""
    return Path(tempfile.mkdtemp(prefix="raybatch-cluster-", dir=bpy.app.tempdir or None))


def load_picture(path: Path) -> bpy.types.Image:
    """The picture in `path` as the data-block `IMAGE`, shown with the scene's view."""
    old = bpy.data.images.get(IMAGE)
    image = bpy.data.images.load(str(path))
    if old is not None:
        old.user_remap(image)  # editors that show the last one
        bpy.data.images.remove(old)
    image.name = IMAGE
    if image.is_float:
        image.use_view_as_render = True
    if image.type == "IMAGE" and image.source == "FILE":
        with contextlib.suppress(RuntimeError):  # it stays where it is
            image.pack()
    return image


def _show(text: str | None) -> None:
    """Show `text` in the status bar, None for what Blender shows there, and draw the panel anew."""
    for workspace in bpy.data.workspaces:
        workspace.status_text_set(None if text is None else f"RayBatch on a cluster: {text}")
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()
