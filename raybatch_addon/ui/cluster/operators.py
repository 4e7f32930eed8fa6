"""Operators: render the file on a cluster, and stop that."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import bpy

from ...blender.cluster.command import WHERE, CommandError, Environment, own_variables
from ...blender.cluster.process import RenderProcess
from ..panel import is_engine, register_all, unregister_all
from ..preferences import own_preferences
from . import running

_PICTURE, _COPY = "picture.exr", "copy.blend"


class RAYBATCH_OT_render_on_cluster(bpy.types.Operator):
    """Render this file on the cluster that the add-on's preferences name, while Blender stays free. What is not saved
    goes there as a copy. The picture is the image “RayBatch Cluster”
    """

    bl_idname = "raybatch.render_on_cluster"
    bl_label = "Render on Cluster"

    animation: bpy.props.BoolProperty(
        name="Animation", description="Render all frames, to the files of the output", default=False
    )

    @classmethod
    def poll(cls, context):
        return is_engine(context) and running.process_running() is None

    def execute(self, context):
        try:
            self._begin(context)
        except CommandError as error:
            self.report({"ERROR"}, f"RayBatch: {error}")
            return {"CANCELLED"}
        return {"FINISHED"}

    def _begin(self, context: bpy.types.Context) -> None:
        environment = named_environment()
        command, where, scene = environment.command(), environment.where(), context.scene
        if not bpy.data.filepath:
            raise CommandError("this file was never saved: save it, so that what it refers to is found from there")
        frames = _frames(scene) if self.animation else ()
        folder = running.new_folder()
        try:
            process = self._begun(scene, folder, command, where, frames)
        except CommandError:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        running.follow_job(running.ClusterJob(process, scene.name, folder, _ended))

    @staticmethod
    def _begun(
        scene: bpy.types.Scene, folder: Path, command: Sequence[str], where: Sequence[str], frames: Sequence[int]
    ) -> RenderProcess:
        """The process of the command line; raises `CommandError`."""
        file = Path(bpy.data.filepath)
        if _is_changed():
            file = folder / _COPY
            try:
                bpy.ops.wm.save_as_mainfile(filepath=str(file), copy=True, relative_remap=True, check_existing=False)
            except RuntimeError as error:
                raise CommandError(f"a copy of the file cannot be saved in {folder}: {error}") from error
        which = [f"--frames={frames[0]}..{frames[-1]}"] if frames else [f"--frame={scene.frame_current}"]
        out = bpy.path.abspath(scene.render.filepath) if frames else str(folder / _PICTURE)
        if frames and scene.render.is_movie_format:
            out = bpy.path.abspath(scene.render.frame_path())
        try:
            return RenderProcess(
                [*command, str(file), *which, "-o", out, *where], own_variables(), frames or (scene.frame_current,)
            )
        except OSError as error:
            raise CommandError(
                f"{command[0]} cannot be run ({error.strerror or error}): choose another Python in {WHERE}"
            ) from error


class RAYBATCH_OT_stop_on_cluster(bpy.types.Operator):
    """Stop the render on the cluster; frames that are finished stay"""

    bl_idname = "raybatch.stop_on_cluster"
    bl_label = "Stop"

    @classmethod
    def poll(cls, _context):
        return running.process_running() is not None

    def execute(self, _context):
        if (process := running.process_running()) is not None:
            process.stop()
        return {"FINISHED"}


def named_environment() -> Environment:
    """What the preferences say; raises `CommandError` where there are none."""
    own = own_preferences()
    if own is None:
        raise CommandError("the add-on is not enabled in Preferences > Add-ons, where a cluster is named: enable it")
    return Environment(bpy.path.abspath(own.cluster_script), bpy.path.abspath(own.cluster_python), own.cluster_address)


def _is_changed() -> bool:
    """Whether the file is not what is on the screen."""
    return bpy.data.is_dirty


def _frames(scene: bpy.types.Scene) -> range:
    """Those of the animation; raises `CommandError`."""
    if scene.frame_step != 1:
        raise CommandError("every frame is rendered on a cluster: set the step of the frame range to 1")
    if scene.frame_end < scene.frame_start:
        raise CommandError("the frame range is empty: set its end behind its start")
    return range(scene.frame_start, scene.frame_end + 1)


def _ended(job: running.ClusterJob) -> None:
    """Show the picture, and say how it went: there is no operator any more to report it."""
    pictures = [path for path in job.process.saved if path.is_file()]
    if pictures:
        try:
            running.load_picture(pictures[-1])
        except RuntimeError as error:  # a movie is none
            job.process.message = f"{pictures[-1].name} is written, and cannot be shown as a picture ({error})"
    if job.error:
        print(f"RayBatch: {job.error}", file=sys.stderr)


_classes = (RAYBATCH_OT_render_on_cluster, RAYBATCH_OT_stop_on_cluster)


def register() -> None:
    """Add the operators."""
    register_all(_classes)


def unregister() -> None:
    """Remove them, and end what they began."""
    if bpy.app.timers.is_registered(running.look_at_job):
        bpy.app.timers.unregister(running.look_at_job)
    running.forget()
    unregister_all(_classes)
