"""One whole render: what is asked for, the scene that it is of, and its time."""

from __future__ import annotations

import time
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import Any

from lib.blend_files import open_blend
from lib.command import UsageError
from rendering.request import ARCHIVE, BLEND, NPZ, RESOLUTION_DEFAULT, kind_of
from rendering.standalone import resized

from benchmarking.scenes import SceneRequest, geometry_scene, refuse_geometry_options
from raybatch_addon.core.errors import RayBatchError, SceneError
from raybatch_addon.core.film import Film
from raybatch_addon.core.scene.archive import load_scene
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings


@dataclass(frozen=True)
class RenderRequest:
    """One call of `benchmark.py render`."""

    scene: SceneRequest
    _: KW_ONLY
    device: str = "AUTO"
    samples: int = 16
    bounces: int = 7
    threads: int = 0  # 0: every core
    runs: int = 3
    size: tuple[int, int] | None = None
    against: str | None = None  # "cycles", "memory" or "devices"
    budgets: str | None = None  # with "memory": as `parse_budgets` takes them
    counters: bool = True  # with "memory": show the time of stages, from renders of their own
    equal_error: bool = False
    picture: Path | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    samples_longer: int = 0  # a second, larger count: show the time of a sample from the two
    samples_given: bool = True  # False: `samples` is what is rendered where nothing else suits the comparison

    @property
    def counts(self) -> tuple[int, int]:
        """Both sample counts."""
        return self.samples, self.samples_longer


@dataclass(frozen=True)
class OpenedScene:
    """The scene to be rendered, opened."""

    name: str
    scene: Scene
    settings: RenderSettings
    blender_scene: Any = None  # of a .blend
    export_seconds: float | None = None


def open_scene(request: RenderRequest) -> OpenedScene:
    """The scene of `request`, in its frame; raises `RayBatchError`."""
    path = request.scene.path
    kind = kind_of(path)
    if not path.is_file():
        raise UsageError(f"there is no file {path}")
    if kind == NPZ:
        return OpenedScene(
            request.scene.name, geometry_scene(request.scene, *(request.size or RESOLUTION_DEFAULT)), RenderSettings()
        )
    refuse_geometry_options(request.scene)
    if kind == BLEND:
        return _open_blend(request)
    if kind != ARCHIVE:
        raise UsageError(
            f"{path} cannot be measured: give a .blend, geometry (.npz), or a scene that render.py --save-scene wrote "
            "(.scene.npz)"
        )
    scene, settings = load_scene(path)
    return OpenedScene(
        path.name,
        resized(scene, *request.size) if request.size else scene,
        settings.replace(device="AUTO", thread_count=0),
    )


def _open_blend(request: RenderRequest) -> OpenedScene:
    path = request.scene.path
    try:
        import bpy
    except ImportError:
        raise UsageError(
            f"{path} needs Blender's Python module bpy, which cannot be imported here; .npz and .scene.npz do without"
        ) from None
    import raybatch_addon
    from raybatch_addon.export.settings import settings_from

    if not hasattr(bpy.types.Scene, "raybatch"):  # of a file that was opened before
        raybatch_addon.register()
    open_blend(path)
    scene = bpy.context.scene
    if request.size:
        scene.render.resolution_x, scene.render.resolution_y = request.size
        scene.render.resolution_percentage = 100
    scene.render.use_border = False  # the whole frame, by either engine
    scene.render.engine = "RAYBATCH"
    exported, seconds = _rendered_scene(scene, bpy.context.view_layer)
    return OpenedScene(path.name, exported, settings_from(scene).replace(device="AUTO", thread_count=0), scene, seconds)


class _SceneTaken(RayBatchError):
    """Ends a render whose scene was all that was wanted."""


def _rendered_scene(scene: Any, layer: Any) -> tuple[Scene, float]:
    """What a render of the view layer `layer` exports, as other depsgraphs have other hair and no motion, and the
    seconds that it takes.
    """
    import bpy

    from raybatch_addon.blender import frame, reports

    taken: list[Scene] = []

    def take(_layer: str, exported: Scene, _settings: RenderSettings) -> None:
        taken.append(exported)
        raise _SceneTaken("the scene is taken")

    uses = [(each, each.use) for each in scene.view_layers]
    for each, _ in uses:
        each.use = each == layer
    frame.scene_listeners.append(take)
    try:
        bpy.ops.render.render()
    except RuntimeError as error:
        if not taken:
            report = reports.last()
            raise SceneError(report.errors[0] if report and report.errors else " ".join(str(error).split())) from None
    finally:
        frame.scene_listeners.remove(take)
        for each, use in uses:
            each.use = use
    if not taken:
        raise SceneError(f"Blender rendered nothing of the scene “{scene.name}”")
    return taken[0], reports.last().export_seconds


@dataclass(frozen=True)
class TimedRender:
    """One whole render."""

    seconds: float
    film: Film


def timed_render(session: Session, scene: Scene, settings: RenderSettings) -> TimedRender:
    """One whole render, tree included: caches of geometry are given back first."""
    session.close()
    start = time.perf_counter()
    film = session.render(scene, settings)
    return TimedRender(time.perf_counter() - start, film)


def scene_report(opened: OpenedScene, reported: dict[str, Any]) -> dict[str, Any]:
    """What every report of whole renders begins with; `reported` are the statistics of one of them."""
    return {
        "scene": opened.name,
        "device": reported["device"],
        "versions": reported["versions"],
        "settings": reported["settings"],
        "frame": reported["frame"],
        "triangles": reported["triangles"],
        "samples_per_pixel": reported["settings"]["sample_count"],
        "bounces": reported["settings"]["bounce_max"],
        "rays": reported["rays"],
        "invalid_samples": reported["invalid_samples"],
        "export_s": None if opened.export_seconds is None else round(opened.export_seconds, 4),
    }
