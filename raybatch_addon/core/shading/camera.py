"""Camera rays."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..errors import SceneError
from ..scene.description import Camera, CameraKind, Panorama
from ..scene.motion import motion_keys
from .panorama import make_panorama_direction, panorama_direction_of, panorama_numbers
from .sampling import sample_aperture
from .stereo import eye_offset, stereo_numbers, towards_convergence


@wp.struct
class CameraData:
    """A camera and its frame on the device."""

    kind: int  # `CameraKind`
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
    projection: wp.vec4  # of a panorama (`panorama_numbers`)
    projection_more: wp.vec4
    # motion; no entries where there is none
    motion_keys: wp.array(dtype=float)  # `motion_keys` of camera to world
    window_steps: wp.array(dtype=wp.vec4)  # left and lower edge, width and height of a pixel at evenly spaced times
    shutter_times: wp.array(dtype=float)  # `Shutter.times`
    rolling: float  # `Shutter.rolling`; below 0: none
    frame_height: float  # [pixels]
    is_stereo: int  # 1: it is an eye of spherical stereo
    stereo: wp.vec4  # of spherical stereo: offset, 1 / convergence distance, angles between which the offset fades


def camera_axes(camera: CameraData) -> wp.mat33:
    """Rows that bring a direction of world space into the camera's: right, up, and away from the camera."""
    x, y, z = (np.array(axis, np.float64) for axis in (camera.axis_x, camera.axis_y, camera.axis_z))
    return wp.mat33(*np.concatenate([x, y, -z]).tolist())


@dataclass(frozen=True)
class CameraFeatures:
    """Features that camera rays are specialised on, under the names that `SceneFeatures` has for them."""

    camera: CameraKind | None = CameraKind.PERSPECTIVE  # None: any, as `CameraData.kind` says
    depth_of_field: bool = False
    spherical_stereo: bool = False


def upload_camera(camera: Camera, width: int, height: int, device: wp.Device | str = "cpu") -> CameraData:
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
    data.kind = int(camera.kind)
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
    set_motion(data, camera, width, height, device)
    if camera.kind.is_panorama:
        numbers = panorama_numbers(camera.kind, camera.panorama or Panorama())
        data.projection, data.projection_more = wp.vec4(*numbers[:4]), wp.vec4(*numbers[4:])
    if camera.stereo:
        offset, *more = stereo_numbers(camera.stereo)
        data.is_stereo = 1
        data.stereo = wp.vec4(-offset if camera.kind == CameraKind.MIRROR_BALL else offset, *more)
    return data


def set_motion(data: CameraData, camera: Camera, width: int, height: int, device: wp.Device | str) -> None:
    """Keys, windows and shutter of a camera that is open for a while."""
    data.rolling, data.frame_height = -1.0 if camera.shutter.rolling is None else camera.shutter.rolling, height
    if camera.shutter.times is not None:
        data.shutter_times = wp.array(camera.shutter.times, dtype=float, device=device)
    if camera.motion is not None:
        data.motion_keys = wp.array(motion_keys(camera.motion).reshape(-1), dtype=float, device=device)
    if camera.window_motion is not None:
        left, right, bottom, top = np.asarray(camera.window_motion, np.float64).T
        steps = np.stack([left, bottom, (right - left) / width, (top - bottom) / height], 1)
        data.window_steps = wp.array(steps.astype(np.float32), dtype=wp.vec4, device=device)


@wp.func
def lens_point(camera: CameraData, u: wp.vec2) -> wp.vec2:
    """A uniform point of the aperture [m]. The squeeze acts on the turned polygon, as in Cycles."""
    p = sample_aperture(u, camera.blade_count, camera.blade_rotation) * camera.lens_radius
    return wp.vec2(p[0] * camera.lens_squeeze, p[1])


# Squared sine of the angle to the side's axis below which a lens takes another side
_ALONG_SIDE = 2.0**-40


@functools.cache
def make_camera_ray(features: CameraFeatures) -> wp.Function:
    """`camera_ray(camera, pixel_x, pixel_y, u_lens) -> (origin, direction, t_max)` for one kind of camera, or for all.

    `pixel_x`, `pixel_y`: position in the full frame [pixels], (0, 0) the lower left corner of its lower left pixel.
    `u_lens`: point of the aperture, in [0, 1)^2. The origin lies on the near plane, the direction is a unit vector, and
    `t_max` [m] ends at the far plane; it is 0 where the camera sees nothing, as beside the circle of a fisheye. Depth
    of field is that of a thin lens.
    """
    if features.camera is None:
        return _make_any_ray(features)
    if features.camera.is_panorama:
        return _make_panorama_ray(features)
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
            if camera.lens_radius > 0.0:
                # all rays of a pixel meet on the plane of focus
                lens = lens_point(camera, u_lens)
                start_x = start_x + lens[0]
                start_y = start_y + lens[1]
                slope_x = slope_x - lens[0] / camera.focus_distance
                slope_y = slope_y - lens[1] / camera.focus_distance
        ahead = slope_x * camera.axis_x + slope_y * camera.axis_y - camera.axis_z
        origin = camera.position + start_x * camera.axis_x + start_y * camera.axis_y + camera.clip_start * ahead
        length = wp.length(ahead)
        if wp.static(features.spherical_stereo and perspective):
            if camera.is_stereo != 0:
                # about the world's vertical, as Cycles does it where the picture is on a plane
                direction = ahead / length
                offset = eye_offset(camera.stereo, direction, wp.vec3(0.0, 0.0, 1.0))
                direction = towards_convergence(camera.stereo, direction, offset)
                origin = origin + offset + camera.clip_start * (length * direction - ahead)
                return origin, direction, camera.clip_length * length
        return origin, ahead / length, camera.clip_length * length

    return camera_ray


def _make_any_ray(features: CameraFeatures) -> wp.Function:
    """`camera_ray` of the camera that `CameraData` describes: a kernel of the general tier has few lines of each."""
    perspective_ray, orthographic_ray = (
        make_camera_ray(dataclasses.replace(features, camera=kind))
        for kind in (CameraKind.PERSPECTIVE, CameraKind.ORTHOGRAPHIC)
    )
    panorama_ray = _make_panorama_ray(features)

    @wp.func
    def camera_ray(
        camera: CameraData, pixel_x: float, pixel_y: float, u_lens: wp.vec2
    ) -> tuple[wp.vec3, wp.vec3, float]:
        if camera.kind == wp.static(int(CameraKind.PERSPECTIVE)):
            return perspective_ray(camera, pixel_x, pixel_y, u_lens)
        if camera.kind == wp.static(int(CameraKind.ORTHOGRAPHIC)):
            return orthographic_ray(camera, pixel_x, pixel_y, u_lens)
        return panorama_ray(camera, pixel_x, pixel_y, u_lens)

    return camera_ray


def _make_panorama_ray(features: CameraFeatures) -> wp.Function:
    """`camera_ray` of a panorama. Cycles has a mirror ball in axes of the other hand: its lens is mirrored."""
    panorama_direction = make_panorama_direction(features.camera) if features.camera else None

    @wp.func
    def camera_ray(
        camera: CameraData, pixel_x: float, pixel_y: float, u_lens: wp.vec2
    ) -> tuple[wp.vec3, wp.vec3, float]:
        x = camera.window_x + pixel_x * camera.pixel_width
        y = camera.window_y + pixel_y * camera.pixel_height
        if wp.static(features.camera is None):
            local = panorama_direction_of(camera.kind, camera.projection, camera.projection_more, x, y)
        else:
            local = panorama_direction(camera.projection, camera.projection_more, x, y)
        if wp.dot(local, local) == 0.0:
            return camera.position, -camera.axis_z, 0.0
        start = wp.vec3(0.0, 0.0, 0.0)
        if wp.static(features.depth_of_field):
            if camera.lens_radius > 0.0:
                # the lens faces every ray; all rays of a pixel meet on the sphere of focus
                lens = lens_point(camera, u_lens)
                # what the first coordinate of the lens is turned towards
                across = wp.vec3(0.0, 0.0, -1.0)
                turn = float(1.0)
                if camera.kind == wp.static(int(CameraKind.MIRROR_BALL)):
                    across = wp.vec3(1.0, 0.0, 0.0)
                    turn = -1.0
                side = across - wp.dot(across, local) * local
                if wp.dot(side, side) < wp.static(_ALONG_SIDE):
                    side = wp.vec3(0.0, 1.0, 0.0)
                side = wp.normalize(side)
                start = lens[0] * side + turn * lens[1] * wp.cross(local, side)
                local = wp.normalize(camera.focus_distance * local - start)
        if wp.static(features.spherical_stereo):
            if camera.is_stereo != 0:
                offset = eye_offset(camera.stereo, local, wp.vec3(0.0, 1.0, 0.0))
                start = start + offset
                local = towards_convergence(camera.stereo, local, offset)
        direction = wp.normalize(local[0] * camera.axis_x + local[1] * camera.axis_y + local[2] * camera.axis_z)
        origin = camera.position + start[0] * camera.axis_x + start[1] * camera.axis_y + start[2] * camera.axis_z
        return origin + camera.clip_start * direction, direction, camera.clip_length

    return camera_ray
