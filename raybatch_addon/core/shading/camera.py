"""Camera rays."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..errors import SceneError
from ..scene.description import Camera, CameraKind
from .sampling import sample_aperture


@wp.struct
class CameraData:
    """A camera and its frame on the device."""

    position: wp.vec3  # [m]
    axis_x: wp.vec3  # axes of the camera in world space, unit
    axis_y: wp.vec3
    axis_z: wp.vec3  # away from the scene
    window_x: float  # left edge of the frame: on the plane one metre ahead (perspective), or of the camera [m]
    window_y: float  # lower edge
    pixel_width: float  # width of a pixel, on the same plane [m]
    pixel_height: float
    clip_start: float  # along the view axis [m]
    clip_length: float  # from the near to the far plane [m]
    lens_radius: float  # [m]
    focus_distance: float  # along the view axis [m]
    blade_count: int  # fewer than 3: a circle
    blade_rotation: float  # [rad]
    lens_squeeze: float  # factor of the aperture's width


@dataclass(frozen=True)
class CameraFeatures:
    """Features that camera rays are specialised on, under the names that `SceneFeatures` has for them."""

    camera: CameraKind = CameraKind.PERSPECTIVE
    depth_of_field: bool = False


def upload_camera(camera: Camera, width: int, height: int) -> CameraData:
    """`camera` for a full frame of `width` x `height` pixels; raises `SceneError` for one that sees nothing."""
    matrix = np.asarray(camera.transform, np.float64)
    left, right, bottom, top = (float(edge) for edge in camera.window)
    if not (np.isfinite(matrix).all() and np.isfinite([left, right, bottom, top]).all()):
        raise SceneError("the camera's matrix or window is not finite; reset the camera's transform")
    if abs(np.linalg.det(matrix[:, :3])) < np.finfo(np.float32).eps or left == right or bottom == top:
        raise SceneError("the camera's matrix or window is singular; give the camera a scale that is not 0")
    if not camera.clip_end > camera.clip_start:
        raise SceneError(
            f"the camera's clip end ({camera.clip_end:g} m) is not beyond its clip start ({camera.clip_start:g} m), "
            "so that it sees nothing; raise the clip end"
        )
    data = CameraData()
    data.axis_x, data.axis_y, data.axis_z, data.position = (wp.vec3(*matrix[:, i]) for i in range(4))
    data.window_x, data.window_y = left, bottom
    data.pixel_width, data.pixel_height = (right - left) / width, (top - bottom) / height
    data.clip_start = camera.clip_start
    data.clip_length = float(camera.clip_end) - float(camera.clip_start)
    data.lens_radius = camera.lens_radius
    data.focus_distance = camera.focus_distance
    data.blade_count = camera.blade_count
    data.blade_rotation = camera.blade_rotation
    data.lens_squeeze = 1 / camera.lens_ratio
    return data


@wp.func
def lens_point(camera: CameraData, u: wp.vec2) -> wp.vec2:
    """A uniform point of the aperture [m]. The squeeze acts on the turned polygon, as in Cycles."""
    p = sample_aperture(u, camera.blade_count, camera.blade_rotation) * camera.lens_radius
    return wp.vec2(p[0] * camera.lens_squeeze, p[1])


@functools.cache
def make_camera_ray(features: CameraFeatures) -> wp.Function:
    """`camera_ray(camera, pixel_x, pixel_y, u_lens) -> (origin, direction, t_max)` for one kind of camera.

    `pixel_x`, `pixel_y`: position in the full frame [pixels], (0, 0) the lower left corner of its lower left pixel.
    `u_lens`: point of the aperture, in [0, 1)^2. The origin lies on the near plane, the direction is a unit vector, and
    `t_max` [m] ends at the far plane. Depth of field is that of a thin lens.
    """
    perspective = features.camera == CameraKind.PERSPECTIVE

    @wp.func
    def camera_ray(
        camera: CameraData, pixel_x: float, pixel_y: float, u_lens: wp.vec2
    ) -> tuple[wp.vec3, wp.vec3, float]:
        x = camera.window_x + pixel_x * camera.pixel_width
        y = camera.window_y + pixel_y * camera.pixel_height
        # in camera space, per metre along the view axis: start + depth * (slope, -1)
        start_x = float(0.0)
        start_y = float(0.0)
        slope_x = float(0.0)
        slope_y = float(0.0)
        if wp.static(perspective):
            slope_x = x
            slope_y = y
        else:
            start_x = x
            start_y = y
        if wp.static(features.depth_of_field):
            # all rays of a pixel meet on the plane of focus
            lens = lens_point(camera, u_lens)
            start_x = start_x + lens[0]
            start_y = start_y + lens[1]
            slope_x = slope_x - lens[0] / camera.focus_distance
            slope_y = slope_y - lens[1] / camera.focus_distance
        ahead = slope_x * camera.axis_x + slope_y * camera.axis_y - camera.axis_z
        origin = camera.position + start_x * camera.axis_x + start_y * camera.axis_y + camera.clip_start * ahead
        length = wp.length(ahead)
        return origin, ahead / length, camera.clip_length * length

    return camera_ray
