"""Cameras of a scene: their projections, when they take the picture, and the frame that they fill."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from enum import IntEnum

import numpy as np


class CameraKind(IntEnum):
    """Projections of cameras."""

    PERSPECTIVE = 0
    ORTHOGRAPHIC = 1
    # panoramas: what `Camera.panorama` describes
    EQUIRECTANGULAR = 2
    EQUIANGULAR_CUBEMAP_FACE = 3  # equal steps are equal angles, along both edges of a cube's face
    MIRROR_BALL = 4
    FISHEYE_EQUIDISTANT = 5
    FISHEYE_EQUISOLID = 6
    FISHEYE_POLYNOMIAL = 7
    CENTRAL_CYLINDRICAL = 8

    @property
    def is_panorama(self) -> bool:
        """Whether the picture is on no plane: rays start at one point, and depth is their length."""
        return self > CameraKind.ORTHOGRAPHIC


@dataclass(frozen=True, kw_only=True)
class Panorama:
    """The projection of a panoramic camera; fields that its kind does not use are ignored."""

    longitude: tuple[float, float] = (-np.pi, np.pi)  # EQUIRECTANGULAR: of the left and right edge, to the right [rad]
    latitude: tuple[float, float] = (-np.pi / 2, np.pi / 2)  # of the lower and upper edge [rad]
    fov: float = np.pi  # fisheyes: the full angle of what is seen [rad]; the rest is black
    focal_length: float = 10.5  # FISHEYE_EQUISOLID, in the unit of `sensor` [mm]
    sensor: tuple[float, float] = (36.0, 24.0)  # FISHEYE_EQUISOLID, FISHEYE_POLYNOMIAL: width and height of the frame
    # FISHEYE_POLYNOMIAL: minus the angle from the axis [rad] is the sum of these times powers 0 to 4 of the distance
    # from the middle of the sensor [mm]
    polynomial: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    cylinder_angles: tuple[float, float] = (-np.pi, np.pi)  # CENTRAL_CYLINDRICAL: of the left and right edge [rad]
    cylinder_heights: tuple[float, float] = (-1.0, 1.0)  # of the lower and upper edge, of a cylinder of radius 1


@dataclass(frozen=True)
class SphericalStereo:
    """An eye that looks past the camera's axis in every direction: it moves sideways as the ray turns."""

    offset: float  # of the eye along the ray's right side [m]; below 0: the left eye
    convergence_distance: float = np.inf  # at which the rays of both eyes meet [m]
    # above and below these angles from the horizon the offset begins to fade, and is gone [rad]; None: it never fades
    pole_angles: tuple[float, float] | None = None


@dataclass(frozen=True)
class Shutter:
    """When the picture is taken; times are 0 where the shutter begins to open, and 1 where it is closed."""

    # the times by which shares 0, ..., 1 of all light have come in, ascending, float32, shape [n >= 2]; None: as much
    # comes in at any time
    times: np.ndarray | None = None
    # rows are exposed one after another from the top, each for this share of the time; None: all of them at once
    rolling: float | None = None


@dataclass(frozen=True)
class Camera:
    """A camera whose rays pass through a window one metre in front of it (PERSPECTIVE)."""

    kind: CameraKind
    transform: np.ndarray  # camera to world, orthonormal axes in the columns, float32, shape [3, 4]
    # left, right, bottom, top edges of the full frame: on the plane z = -1 (PERSPECTIVE) or the camera's plane [m], or
    # of the part of a panorama that is seen, of which (0, 1, 0, 1) is all
    window: tuple[float, float, float, float]
    _: KW_ONLY
    clip_start: float = 0.0  # distance of the near plane along the view axis; of panoramas along the ray [m]
    clip_end: float = np.inf  # distance of the far plane [m]
    lens_radius: float = 0.0  # radius of the aperture [m]; 0: everything is sharp
    focus_distance: float = 1.0  # distance of the sharp plane along the view axis; of panoramas of a sphere [m]
    blade_count: int = 0  # edges of the aperture polygon; fewer than 3: a circle
    blade_rotation: float = 0.0  # [rad]
    lens_ratio: float = 1.0  # anamorphic squeeze: width of the aperture is divided by this
    panorama: Panorama | None = None  # of kinds that are panoramas; None: `Panorama()`
    stereo: SphericalStereo | None = None  # PERSPECTIVE and panoramas
    # `transform` at evenly spaced times while the shutter is open, float32, shape [steps, 3, 4]; None: it stands still
    motion: np.ndarray | None = None
    window_motion: np.ndarray | None = None  # `window` at such times, float32, shape [steps, 4]; None: it stays
    shutter: Shutter = Shutter()
    # for the pass Vector: `transform` and `window` a frame before and a frame after, float32, shapes [2, 3, 4], [2, 4];
    # None: they stay
    frames: np.ndarray | None = None
    window_frames: np.ndarray | None = None


@dataclass(frozen=True)
class Frame:
    """The picture asked for; pixel (0, 0) is at the bottom left, as in Blender."""

    width: int  # width of the full frame [pixels]
    height: int
    _: KW_ONLY
    border: tuple[int, int, int, int] | None = None  # x0, y0, x1, y1: rendered part (end exclusive); None: all
    transparent: bool = False  # the world does not cover the background of the objects: alpha is below 1 there
    glass_roughness: float | None = None  # a transparent film shows through glass up to this; None: through none
    passes: tuple[str, ...] = ("Combined",)  # names of `PASSES` in `scene/passes.py`
    # mist: where it begins, how far behind that it is densest [m], and the exponent of the share between: 0.5, 1 or 2
    mist: tuple[float, float, float] = (0.0, 100.0, 1.0)
    alpha_threshold: float = 0.5  # passes of data show the first surface whose alpha is not below it
    occlusion_distance: float = 3e38  # how far the pass Ambient Occlusion looks [m]

    @property
    def pixel_count(self) -> int:
        """Pixels that are rendered."""
        x0, y0, x1, y1 = self.region
        return (x1 - x0) * (y1 - y0)

    @property
    def region(self) -> tuple[int, int, int, int]:
        """x0, y0, x1, y1 of the rendered part [pixels]."""
        return self.border or (0, 0, self.width, self.height)
