"""The camera at a time: when a path is, and from where and how wide the camera sees then."""

from __future__ import annotations

import warp as wp

from ..native.build import native_source
from ..scene.geometry import mat34
from ..scene.motion import KEY_FLOATS
from .camera import CameraData


@wp.func
def shutter_time(camera: CameraData, y: float, u: float) -> float:
    """When the path of a sample is, 0 to 1, in the row of pixels whose middle is at `y` from the lower edge; `u` in [0,
    1) is its random number.

    With a rolling shutter the row decides, as far as rows are not exposed for long (as in Cycles).
    """
    time = u
    count = camera.shutter_times.shape[0]
    if count > 0:
        at = u * float(count - 1)
        i = wp.min(int(at), count - 2)
        before = camera.shutter_times[i]
        time = before + (at - float(i)) * (camera.shutter_times[i + 1] - before)
    if camera.rolling >= 0.0:
        row = 1.0 - (y - 0.5) / camera.frame_height
        time = 0.5 + (time - 0.5) * camera.rolling + (row - 0.5) * (1.0 - camera.rolling)
    return wp.clamp(time, 0.0, 1.0)


@wp.func_native(native_source("math/motion.h", "math/map_at.h", KEY_FLOATS=KEY_FLOATS))
def _map_at(keys: wp.array(dtype=float), time: float) -> mat34: ...


@wp.func
def camera_at(camera: CameraData, time: float) -> CameraData:
    """`camera` as it is at `time`."""
    seen = camera
    if camera.motion_keys.shape[0] > 0:
        m = _map_at(camera.motion_keys, time)
        seen.axis_x = wp.vec3(m[0, 0], m[1, 0], m[2, 0])
        seen.axis_y = wp.vec3(m[0, 1], m[1, 1], m[2, 1])
        seen.axis_z = wp.vec3(m[0, 2], m[1, 2], m[2, 2])
        seen.position = wp.vec3(m[0, 3], m[1, 3], m[2, 3])
    count = camera.window_steps.shape[0]
    if count > 0:
        at = time * float(count - 1)
        i = wp.clamp(int(at), 0, count - 2)
        before = camera.window_steps[i]
        window = before + (at - float(i)) * (camera.window_steps[i + 1] - before)
        seen.window_x = window[0]
        seen.window_y = window[1]
        seen.pixel_width = window[2]
        seen.pixel_height = window[3]
    return seen
