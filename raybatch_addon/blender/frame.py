"""The final render of one view layer of one frame: export, core, result; and what happens when it fails."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import bpy

from ..convergence import records
from ..core.denoise.library import DenoiseLibrary
from ..core.errors import RayBatchError
from ..core.film import Film
from ..core.measure.parts import PARTS, Parts
from ..core.observers import Progress
from ..core.scene.description import Scene
from ..core.session import Session
from ..core.settings.settings import RenderSettings
from ..export.meshes.persistent import begin_frame
from ..export.passed_over.look import with_light_looked_for
from ..export.passes import SAMPLE_SHARE, wants_sample_share
from ..export.scene import export_scene
from ..export.settings import exposure_of, settings_from
from ..export.view import View
from . import checkpoints, exit_code, finals, missing, reports, tuning
from .cluster import frames_ahead
from .denoise_library import library_for
from .denoising import denoise_film, whole_tile, with_guides
from .result import ResultWriter, check_result_fits, stamp_mattes, view_names
from .sessions import session_for
from .status.status import RenderStatus
from .status.terminal import plain_lines

if TYPE_CHECKING:
    from ..core.cluster.session import ClusterSession

# Called with (view layer name, exported scene, film) after each view layer; for scripts that want more than pixels
film_listeners: list[Callable[[str, Scene, Film], None]] = []
# Called with (view layer name, exported scene, its settings) before each view layer; a `RayBatchError` from it ends the
# render
scene_listeners: list[Callable[[str, Scene, RenderSettings], None]] = []
# Called with the core's `Progress` several times a second
progress_listeners: list[Callable[[Progress], None]] = []

# Called with each note on a render that is no warning
note_listeners: list[Callable[[str], None]] = []
# Asked several times a second whether the render is to end; for scripts, which get signals. What is done is listened to
# as a film, but a picture that lacks samples is an error, so that Blender neither saves it nor goes on to other frames
stop_listeners: list[Callable[[], bool]] = []


def render_view_layer(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> None:
    """Render the depsgraph's view layer into the engine's result; an error becomes a report, never an exception.

    A report of kind ERROR is what keeps Blender from saving the frame. After an error the other view layers of the
    frame are left alone.
    """
    report = engine.report_of_frame
    # with Persistent Data Blender keeps the engine for other frames, and for other renders
    if report is None or (report.job, report.frame) != (finals.job, depsgraph.scene.frame_current):
        missing.begin_look(depsgraph.scene)
        # what is tuned makes no picture: the last one's report stays
        begin = reports.RenderReport if tuning.is_tuning() else reports.begin
        report = engine.report_of_frame = begin(depsgraph.scene.name, depsgraph.scene.frame_current, job=finals.job)
    if report.errors:
        return
    try:
        with finals.under_way():
            _render(engine, depsgraph, report)
    except missing.Refused as error:
        report.refused = True
        _fail(engine, report, str(error))
    except RayBatchError as error:
        _fail(engine, report, str(error))
    except KeyboardInterrupt:
        report.interrupted = True
        _fail(engine, report, "stopped from the keyboard")
    except BaseException as error:  # Blender would go on to save a blank frame, or crash
        traceback.print_exc(file=sys.stderr)
        _fail(engine, report, f"the render failed: {type(error).__name__}: {error}")


def _fail(engine: bpy.types.RenderEngine, report: reports.RenderReport, message: str) -> None:
    line = " ".join(message.split())
    frames_ahead.drop_all()
    report.errors.append(line)
    reports.set_last(report)
    plain_lines.begin()  # Blender prints the error, and nothing of an end behind it
    if bpy.app.background and not bpy.app.module:
        exit_code.end_with(exit_code.RENDER_FAILED)
    engine.report({"ERROR"}, f"RayBatch: {line}")


def _render(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, report: reports.RenderReport) -> None:
    _end_if_asked(None)
    settings = settings_from(depsgraph.scene)
    check_result_fits(depsgraph.scene, depsgraph.view_layer)
    if settings.tile_order == "AUTO" and not bpy.app.background:  # somebody watches
        settings = settings.replace(tile_order="PROGRESSIVE")
    layer_name = depsgraph.view_layer.name
    status = RenderStatus(engine, layer_name, depsgraph.scene.frame_current)
    for name in view_names(engine, layer_name, depsgraph.scene):
        if name:
            engine.active_view_set(name)
        film = _render_view(engine, depsgraph, report, settings, status, View(engine, name))
        if any(listener() for listener in stop_listeners) and not (film and film.complete):
            raise KeyboardInterrupt  # Blender would write what there is, and go on to the next frame
        _end_if_asked(film)
        if _is_stopped(engine):
            frames_ahead.drop_all()
            return


def _end_if_asked(film: Film | None) -> None:
    """An error where the add-on goes and the picture lacks samples."""
    if finals.have_to_end() and not (film and film.complete):
        raise RayBatchError("stopped, as RayBatch was disabled during the render; enable it and render again")


def _is_stopped(engine: bpy.types.RenderEngine) -> bool:
    return engine.test_break() or finals.have_to_end() or any(listener() for listener in stop_listeners)


def _render_view(
    engine: bpy.types.RenderEngine,
    depsgraph: bpy.types.Depsgraph,
    report: reports.RenderReport,
    settings: RenderSettings,
    status: RenderStatus,
    view: View,
) -> Film | None:
    """The film of `view`, which the result shows; None where the render ended before there was one."""
    denoiser = library_for(settings)  # an error about it comes before the render
    layer_name = depsgraph.view_layer.name
    read = None if view.name else frames_ahead.take(finals.job, layer_name, depsgraph.scene.frame_current)
    if read is None:
        status.show(PARTS["export"])
        read = _read(depsgraph, settings, view, lambda: _is_stopped(engine))
    if read is None:
        return None
    try:
        return _render_read(engine, depsgraph, report, read, denoiser, status, view)
    finally:
        frames_ahead.cancel(read)  # where it failed before its film was asked for


def _render_read(
    engine: bpy.types.RenderEngine,
    depsgraph: bpy.types.Depsgraph,
    report: reports.RenderReport,
    read: frames_ahead.ReadFrame,
    denoiser: DenoiseLibrary | None,
    status: RenderStatus,
    view: View,
) -> Film | None:
    """The film of `read`, as `_render_view` returns it."""
    layer_name = depsgraph.view_layer.name

    def is_stopped() -> bool:
        return _is_stopped(engine)

    scene, settings, parts = read.scene, read.settings, read.parts
    report.export_seconds = read.export_seconds
    found = missing.keep_found(depsgraph.scene, layer_name, scene.warnings)
    _report_warnings(engine, report, found)
    if bpy.app.background and not scene_listeners:
        missing.print_new_notices(found, finals.job)
    for scene_listener in scene_listeners:
        scene_listener(layer_name, scene, settings)
    missing.refuse_what_lacks(depsgraph.scene, found)
    if tuning.is_tuning():
        tried = tuning.run_tuning(scene, settings, is_stopped, status.show)
        if tried is not None:
            ResultWriter(engine, layer_name, scene.frame.region[:2], view.name).write(whole_tile(tried))
        return None
    writer = ResultWriter(engine, layer_name, scene.frame.region[:2], view.name, exposure_of(depsgraph.scene))

    def on_progress(progress: Progress) -> None:
        status.update(progress)
        for listener in progress_listeners:
            listener(progress)

    def show_note(text: str) -> None:
        status.show(text)
        engine.report({"INFO"}, f"RayBatch: {text}")
        for listener in note_listeners:
            listener(text)

    recorder = None
    if wants_recording(depsgraph.scene, settings, has_windows=not bpy.app.background):
        recorder = records.recorder_for(
            records.store, depsgraph.scene.name, layer_name, depsgraph.scene.frame_current, settings, view.name
        )
    observers = [recorder] if recorder else []
    film, state = None, records.FAILED
    try:
        parts.enter("start")
        status.show(parts.message)
        with session_for(settings, is_stopped) as session:
            if session is None:
                state = records.CANCELLED
                return None
            seen: dict[str, Any] = {
                "on_tile": writer.write,
                "on_progress": on_progress,
                "cancelled": is_stopped,
                "observers": observers,
            }
            if isinstance(session, Session):
                checkpoint = checkpoints.checkpoint_of(depsgraph.scene, layer_name, view.name, show_note)
                first = checkpoints.first_sample()
                film = session.render(scene, settings, **seen, sample_first=first, parts=parts, checkpoint=checkpoint)
            else:
                film = _render_ahead(engine, depsgraph, session, read, view, seen)
            if denoiser is not None:  # viewports, which would take its processors, wait for it too
                parts.enter("denoise")
                status.show(parts.message)
                denoise_film(film, settings, denoiser, is_stopped)
    finally:
        if recorder:
            if film is not None:
                state = records.FINISHED if film.complete else records.CANCELLED
            recorder.end(state, None if film is None else film.statistics)
    parts.enter("write")
    if wants_sample_share(depsgraph.view_layer):
        film.made[SAMPLE_SHARE] = film.sample_share
    if film.made:
        status.show(parts.message)
        writer.write(whole_tile(film))
    stamp_mattes(engine, layer_name, scene)
    status.end(film, settings.sample_count)
    film.statistics["seconds"] = parts.record()
    report.statistics[f"{layer_name}, {view.name}" if view.name else layer_name] = film.statistics
    _report_warnings(engine, report, film.statistics["warnings"])
    if view.name:
        film.statistics["frame"] = {**film.statistics.get("frame", {}), "view": view.name}
    for film_listener in film_listeners:
        film_listener(layer_name, scene, film)
    return film


def _read(
    depsgraph: bpy.types.Depsgraph, settings: RenderSettings, view: View, is_stopped: Callable[[], bool]
) -> frames_ahead.ReadFrame | None:
    """The frame that the depsgraph is at, as it is to be rendered; None once `is_stopped()`."""
    parts = Parts("export")
    begin_frame(finals.job)
    scene = export_scene(depsgraph, cancelled=is_stopped, view=view)
    if scene is None:
        return None
    read = frames_ahead.ReadFrame(scene, settings, parts)
    read.scene = with_guides(with_light_looked_for(scene), settings)
    return read


def _render_ahead(
    engine: bpy.types.RenderEngine,
    depsgraph: bpy.types.Depsgraph,
    session: ClusterSession,
    read: frames_ahead.ReadFrame,
    view: View,
    seen: dict[str, Any],
) -> Film:
    """The film of `read`, and the next frame of an animation begun meanwhile; `seen` are arguments of
    `PendingFilm.film`.
    """
    scene, is_stopped = depsgraph.scene, seen["cancelled"]

    def begin(frame: frames_ahead.ReadFrame, is_ahead: bool) -> None:
        layer = depsgraph.view_layer.name
        checkpoint = checkpoints.checkpoint_of(scene, layer, view.name, lambda text: None, is_ahead)
        first = checkpoints.first_sample()
        frame.pending = session.begin(
            frame.scene, frame.settings, sample_first=first, parts=frame.parts, checkpoint=checkpoint
        )

    def begin_next() -> frames_ahead.ReadFrame | None:
        following = _read(depsgraph, settings_from(scene), view, is_stopped)
        if following is not None:
            begin(following, is_ahead=True)
        return following

    if read.pending is None:
        begin(read, is_ahead=False)
    assert read.pending is not None  # since now at the latest
    if not view.name:
        frames_ahead.begin_next(engine, depsgraph, session, finals.job, begin_next)
    film = read.pending.film(**seen)
    frames_ahead.note_film(film)
    return film


def wants_recording(scene: bpy.types.Scene, settings: RenderSettings, has_windows: bool) -> bool:
    """Whether error and rays a second over time are to be kept: where the panel was asked to, or shows an error that is
    estimated anyway.

    Without windows nobody looks at the panel, and to be looked at a render is cut into rounds, which take time. What it
    needs to end at an error or by the clock it looks at itself.
    """
    own = getattr(scene, "raybatch_convergence", None)
    return bool(own and own.record) or (has_windows and settings.half_count > 1)


def _report_warnings(engine: bpy.types.RenderEngine, report: reports.RenderReport, warnings: Sequence[str]) -> None:
    new = [text for text in warnings if text not in report.warnings]
    report.warnings += new
    if new:
        more = f" (and {len(new) - 1} more, listed in the panel Last Render)" if len(new) > 1 else ""
        engine.report({"WARNING"}, f"RayBatch: {new[0]}{more}")
