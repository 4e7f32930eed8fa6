"""Renders through Blender (the bpy module): .blend files, and geometry that Blender imports."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
from lib.blend_files import open_blend
from lib.command import RefusedError, UsageError, first_line
from lib.output import OutputFolders, described, numbered, print_notes, print_saved, print_warnings, write_json

import raybatch_addon
from raybatch_addon.blender import checkpoints, reports, sessions
from raybatch_addon.blender.checkpoints import AskedCheckpoint
from raybatch_addon.core.cluster.session import ClusterSession
from raybatch_addon.core.errors import RayBatchError, SceneError
from raybatch_addon.core.film import Film
from raybatch_addon.core.observers import Progress
from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.scene.passes import GUIDE_PASSES
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.export.camera import no_camera
from raybatch_addon.export.passes import (
    LIGHT_PASS_PROPERTIES,
    MATTE_PROPERTIES,
    OWN_PASS_PROPERTIES,
    PASS_PROPERTIES,
    VOLUME_PASS_PROPERTIES,
)
from raybatch_addon.export.settings import assign_setting, settings_from
from raybatch_addon.export.taken_over import take
from rendering.deliveries import FrameDeliveries, FrameFiles
from rendering.formats import FORMATS, UNWRITTEN, choose_format, picture_formats, set_format, unwritten_passes
from rendering.imported import import_geometry
from rendering.progress import ProgressBar
from rendering.request import BLEND, Request
from rendering.stops import StopRequests
from rendering.workshop import Workshop

FRAME_FIRST = 0  # the first that Blender lets an animation have


class _SceneSaved(RayBatchError):
    """Ends a render whose scene was all that was wanted."""


class BlenderRender:
    """The renders of one request."""

    def __init__(
        self,
        request: Request,
        folders: OutputFolders,
        bar: ProgressBar,
        standard_output,
        opened: Callable[[RenderSettings], ClusterSession] | None = None,
    ) -> None:
        """The session that `opened` returns for the file's settings, if it is given, renders instead of this
        process.
        """
        self._opened = opened
        self._request, self._folders, self._bar, self._standard_output = request, folders, bar, standard_output
        self._films: list[tuple[str, Film]] = []  # of the frame in work, by view layer
        self._statistics: list[dict[str, Any]] = []
        self._scene_saved = False
        self._shown: set[str] = set()  # messages about the exported scenes of all frames so far
        self._stops = StopRequests()
        self._is_failed: Callable[[], bool] = lambda: False  # a frame could not be written

    def run(self) -> None:
        """Open, render and write what was asked for; raises `RayBatchError`."""
        request = self._request
        raybatch_addon.register()
        try:
            self._listen()
            _open(request)
            scene = bpy.context.scene
            _choose_view_layers(scene, request.view_layers)
            _ask_for_passes(scene, request.passes)
            choose_format(scene, request)
            if unwritten := unwritten_passes(scene, request):
                print_notes([unwritten])
            frames = request.frames or (scene.frame_current,)
            _take_over_settings(scene, request)
            if request.strict:
                scene.raybatch_export.strict = request.strict
            if request.save_scene and (len(frames) > 1 or sum(layer.use for layer in scene.view_layers) > 1):
                raise UsageError(
                    "--save-scene holds one picture: choose one frame with --frame and one layer with --view-layer"
                )
            if self._opened is not None:
                session = self._opened(settings_from(scene))
                sessions.instead = lambda settings: session
            with self._stops:
                if request.out and scene.render.is_movie_format and not picture_formats(request.out):
                    self._render_movie(scene, Path(_absolute(request.out)), frames)
                else:
                    self._render_stills(scene, frames)
        except KeyboardInterrupt:
            self._report()
            raise
        except Exception:
            if self._statistics:  # of pictures before the one that failed
                self._report()
            raise
        finally:
            self._bar.close()
            checkpoints.asked = None
            take.of_command.clear()
        self._report()

    def _report(self) -> None:
        if self._request.json:
            write_json(self._request.json, self._statistics, self._standard_output)

    # --- what the engine reports

    def _listen(self) -> None:
        from raybatch_addon.blender import frame

        frame.progress_listeners.append(self._on_progress)
        frame.scene_listeners.append(self._on_scene)
        frame.film_listeners.append(self._on_film)
        frame.stop_listeners.append(self._is_stopped)
        frame.note_listeners.append(lambda text: print_notes([text]))

    def _on_progress(self, progress: Progress) -> None:
        self._bar.show(progress, bpy.context.scene.frame_current)

    def _is_stopped(self) -> bool:
        return self._stops.asked() or self._is_failed()

    def _on_scene(self, _layer: str, exported: Scene, settings: RenderSettings) -> None:
        print_warnings(text for text in exported.warnings if text not in self._shown)
        self._shown.update(exported.warnings)
        if self._request.save_scene and not self._scene_saved:
            path = Path(self._request.save_scene).absolute()
            save_scene(path, exported, settings)
            print_saved(path, "the scene")
            self._scene_saved = True
            if not self._request.renders:
                raise _SceneSaved("the scene is saved")

    def _on_film(self, layer: str, _exported: Scene, film: Film) -> None:
        print_warnings(text for text in film.statistics["warnings"] if text not in self._shown)
        self._statistics.append(described(film, bpy.context.scene.frame_current, layer))
        if self._request.film or self._request.heat_maps:
            view = film.statistics.get("frame", {}).get("view")
            self._films.append((f"{layer}/{view}" if view else layer, film))

    # --- rendering

    def _render_stills(self, scene: bpy.types.Scene, frames: tuple[int, ...]) -> None:
        request, many = self._request, len(frames) > 1
        places = [_still_path(scene, request.out, number, many) if request.out else None for number in frames]
        print_notes(_names_to_know(request.out))
        files = [FrameFiles.of(request, number, many, place) for number, place in zip(frames, places, strict=True)]
        for path in {path.parent: path for each in files for path in each.paths}.values():
            self._folders.prepare(path)
        if not request.out:
            set_format(scene, FORMATS[".bmp"])  # of pictures that nobody keeps
        deliveries = FrameDeliveries(request, files, self._bar, self._films, self._stops.asked)
        try:
            self._deliver(scene, frames, deliveries)
        except KeyboardInterrupt:
            if many:
                print_notes([deliveries.how_far])  # all of it is written now
            raise

    def _deliver(self, scene: bpy.types.Scene, frames: tuple[int, ...], deliveries: FrameDeliveries) -> None:
        request = self._request
        with deliveries:
            self._is_failed = lambda: deliveries.failure is not None
            scene.render.filepath = deliveries.output
            try:
                self._render_frames(scene, frames)
            except KeyboardInterrupt:
                if deliveries.failure is None and not deliveries.are_complete:
                    raise
            if deliveries.failure is not None:
                raise deliveries.failure
            if request.renders and not deliveries.are_complete:
                raise RayBatchError(f"Blender ended the render before all of its {len(frames)} frames were written")

    def _render_frames(self, scene: bpy.types.Scene, frames: tuple[int, ...]) -> None:
        if len(frames) > 1 and frames[0] >= FRAME_FIRST:
            # as one animation: Blender evaluates each frame once, and only what changed is read again
            scene.render.use_persistent_data = True
            scene.frame_start, scene.frame_end, scene.frame_step = frames[0], frames[-1], 1
            self._operate(animation=True)
            return
        for number in frames:
            scene.frame_set(number)
            self._operate(write_still=bool(self._request.out))

    def _render_movie(self, scene: bpy.types.Scene, out: Path, frames: tuple[int, ...]) -> None:
        if self._request.film or self._request.heat_maps or self._request.checkpoint:
            raise UsageError("--film, --heat-map and --checkpoint are for still pictures; the file renders a movie")
        self._folders.prepare(out)
        checkpoints.asked = AskedCheckpoint(None, sample_first=self._request.sample_first)
        scene.frame_start, scene.frame_end, scene.frame_step = frames[0], frames[-1], 1
        with Workshop(out.parent) as workshop:
            scene.render.filepath = str(workshop.folder / out.name)
            self._operate(animation=True)
            workshop.deliver(None)

    def _operate(self, **how: bool) -> None:
        """Let Blender render; its errors and the engine's become a `RayBatchError`."""
        before = reports.last()
        try:
            bpy.ops.render.render(**how)
            if self._is_stopped():
                raise KeyboardInterrupt
        except RuntimeError as error:
            report = reports.last()
            if report is not None and report is not before and report.interrupted:
                raise KeyboardInterrupt from None
            reported = report.errors if report is not None and report is not before else []
            if self._scene_saved and not self._request.renders:
                return
            kind = RefusedError if report is not None and report is not before and report.refused else SceneError
            said = reported[0] if reported else first_line(error)
            if not reported and bpy.context.scene.camera is None and "camera" in said:
                said = no_camera(bpy.context.scene.name)  # Blender looks for one before any engine does
            raise kind(f"{self._bar.label}{said}") from None
        if (report := reports.last()) is not None and report is not before and report.errors and not self._scene_saved:
            if report.interrupted:
                raise KeyboardInterrupt
            raise (RefusedError if report.refused else SceneError)(f"{self._bar.label}{report.errors[0]}")


def _open(request: Request) -> None:
    """Open or import the request's file, with RayBatch as its engine."""
    if not request.source.is_file():
        raise SceneError(f"there is no file {request.source}")
    if request.kind == BLEND:
        if request.camera or request.up:
            raise UsageError(f"{request.source} has a camera of its own; --camera and --up are for geometry files")
        open_blend(request.source)
    else:
        if request.frames is not None or request.view_layers:
            raise UsageError(
                f"{request.source} holds one picture; --frame, --frames and --view-layer are for .blend files"
            )
        import_geometry(request)
    bpy.context.scene.render.engine = "RAYBATCH"


def _choose_view_layers(scene: bpy.types.Scene, names: tuple[str, ...]) -> None:
    there = [layer.name for layer in scene.view_layers]
    for name in names:
        if name not in there:
            raise UsageError(f"there is no view layer {name!r}; there is {', '.join(there)}")
    for layer in scene.view_layers:
        if names:
            layer.use = layer.name in names
    if names:
        scene.render.use_single_layer = False


def _take_over_settings(scene: bpy.types.Scene, request: Request) -> None:
    """The settings of another engine, where asked for, and those of the command line on top of them."""
    if request.settings_from:
        changed = take.take_over(scene, request.settings_from)
        print_notes(each.taken(request.settings_from) for each in changed if each.setting not in request.settings)
    _apply_settings(scene, request)


def _apply_settings(scene: bpy.types.Scene, request: Request) -> None:
    take.of_command.update(request.settings)
    for name, value in request.settings.items():
        assign_setting(scene.raybatch, name, value)
    settings_from(scene)  # values that do not go together are reported before the render
    if request.resolution:
        scene.render.resolution_x, scene.render.resolution_y = request.resolution
        scene.render.resolution_percentage = 100


def _ask_for_passes(scene: bpy.types.Scene, names: tuple[str, ...]) -> None:
    """Let all view layers render the passes `names` beside those that they have."""
    of_cycles = [name for name in names if name in (*GUIDE_PASSES, *VOLUME_PASS_PROPERTIES.values())]
    for layer in scene.view_layers:
        if of_cycles and not hasattr(layer, "cycles"):
            raise UsageError(f"the pass {of_cycles[0]!r} is a setting of Cycles, whose add-on is not enabled")
        if not set(of_cycles).isdisjoint(GUIDE_PASSES):
            layer.cycles.denoising_store_passes = True
        for owner, properties in (
            (layer, PASS_PROPERTIES | LIGHT_PASS_PROPERTIES),
            (getattr(layer, "cycles", None), VOLUME_PASS_PROPERTIES),
            (layer.raybatch, OWN_PASS_PROPERTIES),
        ):
            for prop, name in properties.items():
                if name in names and owner is not None:
                    setattr(owner, prop, True)
        for prop, kind in MATTE_PROPERTIES.items():
            levels = [2 * int(name[-2:]) + 2 for name in names if name.startswith(kind)]
            if levels:
                setattr(layer, prop, True)
                layer.pass_cryptomatte_depth = max(layer.pass_cryptomatte_depth, *levels)


def _absolute(out: str) -> str:
    """`out` from the current folder, or from the .blend's where it begins with `//` as Blender has it."""
    return os.path.abspath(bpy.path.abspath(out) if out.startswith("//") else out)


def _still_path(scene: bpy.types.Scene, out: str, number: int, many: bool) -> Path:
    """The file of frame `number`: as Blender names it, except that a picture's full name is taken as it is."""
    path = _absolute(out) + (os.sep if out.endswith(("/", os.sep)) else "")
    if picture_formats(out) and ("#" in os.path.basename(out) or not many):
        return numbered(path, number, many)
    if picture_formats(out):
        stem, extension = os.path.splitext(path)
        return Path(f"{stem}{number:04d}{extension}")
    before = scene.render.filepath
    scene.render.filepath = path
    try:
        return Path(scene.render.frame_path(frame=number))
    finally:
        scene.render.filepath = before


def _names_to_know(out: str | None) -> list[str]:
    """Notes where `out` is named as Blender does it, which may not have been meant. Raises `UsageError` where it can
    hardly have been.
    """
    if not out or picture_formats(out) or out.endswith(("/", os.sep)):
        return []
    if os.path.isdir(_absolute(out)):
        return [f"{out} is a folder, and pictures get its name with a number behind; write {out}/ to have them in it"]
    extension = os.path.splitext(out)[1]
    if extension.lower() in UNWRITTEN:
        raise UsageError(f"Blender writes no {extension}: give {out} one of the extensions {', '.join(FORMATS)}")
    if meant := [each for each in FORMATS if sorted(each) == sorted(extension.lower())]:
        raise UsageError(f"{out}: {extension} is no picture's extension; did you mean {meant[0]}?")
    if extension and "#" not in extension:
        why = f"{extension} is no picture's extension"
        return [f"{why}: {out} is a name as Blender has it, with a number and an extension behind"]
    return []
