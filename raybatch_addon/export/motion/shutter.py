"""The shutter of a render: when it is open, its curve, and Blender's scene at times in between."""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.scene.description import Shutter
from ...core.scene.notice import Notice, Weight
from ..view import View

_CURVE_STEPS = 256
# By how much of the time of a shutter its middle lies behind the frame
_MIDDLE = {"START": 0.5, "CENTER": 0.0, "END": -0.5}


@dataclass(frozen=True)
class Exposure:
    """The time in which the shutter of a frame is open; `None` of `open_time` where it is open for no time."""

    view: View
    frame: float  # that is rendered
    middle: float  # of the time [frames]
    length: float  # [frames]
    fps: float

    def go_to(self, time: float) -> None:
        """Evaluate the scene at `time`, -1 where the shutter begins to open and 1 where it is closed."""
        self._set(self.middle + time * self.length / 2)

    def go_back(self) -> None:
        """Evaluate the scene at its frame again."""
        self._set(self.frame)

    def _set(self, frame: float) -> None:
        assert self.view.engine is not None, "nobody sets the frame"
        whole = math.floor(frame)
        self.view.engine.frame_set(whole, frame - whole)


def open_time(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, view: View, warnings: list[str]):
    """The `Exposure` of a frame of `scene`; None where motion blur is off."""
    render = scene.render
    if not render.use_motion_blur or not getattr(view_layer, "use_motion_blur", True):
        return None
    if view.is_look:
        return None
    if view.engine is None:
        text = f"scene “{scene.name}”: without a render engine nothing moves; the frame is rendered sharp"
        warnings.append(Notice(text, Weight.MISSING))
        return None
    length = float(render.motion_blur_shutter)
    if not length > 0:
        return None
    frame = scene.frame_current + scene.frame_subframe
    middle = frame + _MIDDLE[render.motion_blur_position] * length
    return Exposure(view, frame, middle, length, render.fps / render.fps_base)


def neighbours(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, view: View, warnings: list[str]):
    """The time from the frame before to the frame after, for the pass Vector; None where it is not asked for."""
    if not view_layer.use_pass_vector or view.engine is None:
        return None
    if scene.render.use_motion_blur:
        text = f"scene “{scene.name}”: with motion blur the pass Vector shows no motion, as in Cycles"
        warnings.append(Notice(text, Weight.REPAIRED, remedy="turn off Motion Blur, or the pass"))
        return None
    frame = scene.frame_current + scene.frame_subframe
    return Exposure(view, frame, frame, 2.0, scene.render.fps / scene.render.fps_base)


def export_shutter(scene: bpy.types.Scene) -> Shutter:
    """The shutter's curve, and how rows are exposed (a setting of Cycles)."""
    cycles = getattr(scene, "cycles", None)
    duration = None
    if cycles is not None and getattr(cycles, "rolling_shutter_type", "NONE") == "TOP":
        duration = cycles.rolling_shutter_duration
    return Shutter(_times(scene.render.motion_blur_shutter_curve), duration)


def _times(mapping: bpy.types.CurveMapping) -> np.ndarray | None:
    """Times by which shares of all light have come in, from the curve of how far the shutter is open; None where it is
    open alike all the time.
    """
    mapping.update()
    curve = mapping.curves[0]
    if len({point.location[1] for point in curve.points}) == 1:
        return None
    x = np.linspace(0, 1, _CURVE_STEPS)
    opening = np.abs([mapping.evaluate(curve, float(each)) for each in x])
    if not np.isfinite(opening).all() or opening.max() == 0 or np.ptp(opening) < 1e-6 * opening.max():
        return None
    light = np.concatenate([[0], np.cumsum(opening)]) / opening.sum()
    edges = np.linspace(0, 1, len(light))
    # where nothing comes in, time stands at the end of it
    rising = np.concatenate([[True], np.diff(light) > 0])
    return np.interp(np.linspace(0, 1, _CURVE_STEPS + 1), light[rising], edges[rising]).astype(np.float32)
