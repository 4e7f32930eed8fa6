"""How the time of an animation is spent, and whether its memory grows: rendered by Blender, with Persistent Data."""

from __future__ import annotations

import gc
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
from lib.blend_files import open_blend

import raybatch_addon
from benchmarking.in_blender.moving_scene import SIZES, make_moving_scene
from benchmarking.progress import Steps
from raybatch_addon.blender import frame, reports
from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.film import Film
from raybatch_addon.core.host_memory import host_memory_used
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.export.settings import assign_setting, settings_from

# Parts of a frame that are reported: those of a render, and what Blender does beside it
FRAME_PARTS = ("export", "build", "render", "raybatch", "evaluation", "whole")
MEMORY_POINTS = 10  # so often memory is looked at


@dataclass(frozen=True, kw_only=True)
class AnimationRequest:
    """One call of `benchmark.py animation`."""

    path: Path | None = None  # a .blend; None: a scene is made
    size: str = "large"  # of what is made, one of `SIZES`
    frames: int = 100
    samples: int = 4
    device: str = "AUTO"
    threads: int = 0  # 0: every core
    resolution: tuple[int, int] | None = None  # None: the file's
    settings: dict[str, Any] = field(default_factory=dict)


def measure_animation(request: AnimationRequest) -> dict[str, Any]:
    """The report of `benchmark.py animation`; raises `RayBatchError`."""
    raybatch_addon.register()
    name = _open(request)
    scene = bpy.context.scene
    first = scene.frame_start
    _set_up(scene, request)
    steps = Steps(request.frames)
    with tempfile.TemporaryDirectory() as folder, _clock(request.frames, steps) as clock:
        scene.render.filepath = f"{folder}/"
        before = reports.last()
        try:
            bpy.ops.render.render(animation=True)
        except RuntimeError as error:
            raise SceneError(_failure(before) or " ".join(str(error).split())) from None
        finally:
            steps.close()
    if said := _failure(before):
        raise SceneError(said)
    if len(clock.seconds) != request.frames:
        raise SceneError(f"Blender rendered {len(clock.seconds)} of {request.frames} frames")
    return {
        "scene": name,
        "frames": request.frames,
        "frame_first": first,
        **{key: clock.statistics[key] for key in ("device", "versions", "settings", "frame", "triangles")},
        "samples_per_pixel": clock.statistics["settings"]["sample_count"],
        **times(clock.seconds),
        "trees": {"built": sum(built for built, _ in clock.trees[1:]), "refitted": sum(n for _, n in clock.trees[1:])},
        "resident": clock.resident,
        "resident_growth_mib": round(clock.resident[-1]["mib"] - clock.resident[0]["mib"], 1),
    }


def times(seconds: list[dict[str, float]]) -> dict[str, Any]:
    """Seconds of frames by part: of the first, which reads, builds and loads everything; of the others; and what share
    of the time, Blender's included, export and build have.
    """
    later = seconds[1:] or seconds

    def share(frames: list[dict[str, float]]) -> float:
        return round(sum(each["export"] + each["build"] for each in frames) / sum(each["whole"] for each in frames), 4)

    return {
        "first_frame": {part: round(seconds[0][part], 4) for part in FRAME_PARTS},
        "seconds": {
            part: {
                "median": round(statistics.median(each[part] for each in later), 5),
                "sum": round(sum(each[part] for each in seconds), 4),
            }
            for part in FRAME_PARTS
        },
        "export_and_build_share": share(seconds),
        "export_and_build_share_after_first": share(later),
    }


class _Clock:
    """Hears from Blender and the engine where a frame begins and ends."""

    def __init__(self, frames: int, steps: Steps) -> None:
        self._frames, self._steps = frames, steps
        self._now: dict[str, float] = {}  # when parts of the frame in work began
        self._frame: dict[str, float] = {}
        self.seconds: list[dict[str, float]] = []  # by frame and part
        self.trees: list[tuple[int, int]] = []  # built and refitted, by frame
        self.resident: list[dict[str, Any]] = []
        self.statistics: dict[str, Any] = {}  # of the last frame

    def begin(self, *_: Any) -> None:
        """Blender begins a frame."""
        self._frame = dict.fromkeys(FRAME_PARTS, 0.0)
        self._now["whole"] = time.perf_counter()
        self._steps.begin(f"frame {len(self.seconds) + 1}")

    def begin_evaluation(self, *_: Any) -> None:
        """Blender goes to another frame of its scene."""
        self._now["evaluation"] = time.perf_counter()

    def end_evaluation(self, *_: Any) -> None:
        """It has gone there."""
        if "evaluation" in self._now and self._frame:
            self._frame["evaluation"] += time.perf_counter() - self._now.pop("evaluation")

    def hear(self, _layer: str, _scene: Scene, film: Film) -> None:
        """A view layer is rendered."""
        self.statistics, spent = film.statistics, film.statistics["seconds"]
        for part, name in (("export", "export"), ("build", "build"), ("render", "render"), ("raybatch", "total")):
            self._frame[part] += spent[name]
        tree = film.statistics.get("tree") or {}
        self.trees.append((tree.get("built", 0), tree.get("refitted", 0)))

    def end(self, *_: Any) -> None:
        """The picture of a frame is written."""
        self._frame["whole"] = time.perf_counter() - self._now["whole"]
        self.seconds.append(self._frame)
        self._frame = {}
        count = len(self.seconds)
        if count * MEMORY_POINTS // self._frames > (count - 1) * MEMORY_POINTS // self._frames:
            gc.collect()
            self.resident.append({"after_frames": count, "mib": round(host_memory_used() / 2**20, 1)})
        self._steps.end()


@contextmanager
def _clock(frames: int, steps: Steps) -> Iterator[_Clock]:
    clock, handlers = _Clock(frames, steps), bpy.app.handlers
    heard: list[tuple[list, Callable]] = [
        (handlers.render_pre, clock.begin),
        (handlers.frame_change_pre, clock.begin_evaluation),
        (handlers.frame_change_post, clock.end_evaluation),
        (handlers.render_write, clock.end),
        (frame.film_listeners, clock.hear),
    ]
    for listeners, listener in heard:
        listeners.append(listener)
    try:
        yield clock
    finally:
        for listeners, listener in heard:
            listeners.remove(listener)


def _open(request: AnimationRequest) -> str:
    """Open or make the scene; its name in reports."""
    if request.path is None:
        make_moving_scene(SIZES[request.size], request.frames)
        return f"{request.size}, made"
    open_blend(request.path)
    return request.path.name


def _set_up(scene: bpy.types.Scene, request: AnimationRequest) -> None:
    render, image = scene.render, scene.render.image_settings
    render.engine, render.use_persistent_data = "RAYBATCH", True
    scene.frame_end, scene.frame_step = scene.frame_start + request.frames - 1, 1
    if request.resolution:
        render.resolution_x, render.resolution_y = request.resolution
        render.resolution_percentage = 100
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format = "BMP"  # of pictures that nobody keeps
    render.use_overwrite, render.use_file_extension = True, True
    asked = {"device": request.device, "thread_count": request.threads, "sample_count": request.samples}
    for name, value in (asked | request.settings).items():
        assign_setting(scene.raybatch, name, value)
    settings_from(scene)  # values that do not go together are reported before the render


def _failure(before: reports.RenderReport | None) -> str:
    """What the last render failed for; nothing where it did not. `before`: the report that there was before it."""
    report = reports.last()
    return report.errors[0] if report is not None and report is not before and report.errors else ""
