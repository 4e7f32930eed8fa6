"""Blender's panoramic cameras and stereo eyes as the core describes them."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from ..core.scene.description import CameraKind, Panorama, SphericalStereo
from ..core.scene.notice import Notice, Weight

_KINDS = {
    "EQUIRECTANGULAR": CameraKind.EQUIRECTANGULAR,
    "EQUIANGULAR_CUBEMAP_FACE": CameraKind.EQUIANGULAR_CUBEMAP_FACE,
    "MIRRORBALL": CameraKind.MIRROR_BALL,
    "FISHEYE_EQUIDISTANT": CameraKind.FISHEYE_EQUIDISTANT,
    "FISHEYE_EQUISOLID": CameraKind.FISHEYE_EQUISOLID,
    "FISHEYE_LENS_POLYNOMIAL": CameraKind.FISHEYE_POLYNOMIAL,
    "CENTRAL_CYLINDRICAL": CameraKind.CENTRAL_CYLINDRICAL,
}


def panorama_settings(camera: bpy.types.Camera) -> Any:
    """Where the settings of panoramas are: in Blender 5 at the camera, before that among those of Cycles, which are
    there while its add-on is enabled. None: there are none.
    """
    return camera if hasattr(camera, "panorama_type") else getattr(camera, "cycles", None)


def panorama_kind(camera: bpy.types.Camera, name: str, warnings: list[str]) -> CameraKind:
    """The kind of a camera of the type PANO; messages call it `name`."""
    settings = panorama_settings(camera)
    if settings is None:
        text = (
            f"{name}: settings of panoramas are those of Cycles, whose add-on is disabled; it is equirectangular here"
        )
        warnings.append(Notice(text, Weight.MISSING, remedy="enable the add-on Cycles"))
        return CameraKind.EQUIRECTANGULAR
    kind = _KINDS.get(settings.panorama_type)
    if kind is None:
        label = settings.panorama_type.lower().replace("_", " ")
        text = f"{name}: panoramas of type {label} are not supported; it is rendered as a fisheye lens"
        warnings.append(Notice(text, Weight.MISSING))
        return CameraKind.FISHEYE_EQUISOLID
    return kind


def export_panorama(camera: bpy.types.Camera, span: np.ndarray) -> Panorama:
    """The projection of a panoramic camera; `span` is the frame's width and height, of pixels that may be oblong."""
    settings = panorama_settings(camera)
    if settings is None:
        return Panorama()
    fit = camera.sensor_fit
    along = {"HORIZONTAL": 0, "VERTICAL": 1}.get(fit, int(span[1] >= span[0]))
    size = camera.sensor_height if fit == "VERTICAL" else camera.sensor_width
    # a cylinder's heights are in units of its radius
    radius = getattr(settings, "central_cylindrical_radius", 1.0)
    heights = [getattr(settings, f"central_cylindrical_range_v_{end}", value) for end, value in _ENDS]
    angles = [getattr(settings, f"central_cylindrical_range_u_{end}", value * np.pi) for end, value in _ENDS]
    width, height = (float(each) for each in size * span / span[along])
    return Panorama(
        longitude=(settings.longitude_min, settings.longitude_max),
        latitude=(settings.latitude_min, settings.latitude_max),
        fov=settings.fisheye_fov,
        focal_length=settings.fisheye_lens,
        sensor=(width, height),
        polynomial=tuple(getattr(settings, f"fisheye_polynomial_k{power}") for power in range(5)),
        cylinder_angles=(angles[0], angles[1]),
        cylinder_heights=(heights[0] / radius, heights[1] / radius),
    )


_ENDS = (("min", -1.0), ("max", 1.0))


def export_stereo(camera: bpy.types.Camera, view: str) -> SphericalStereo | None:
    """The eye of a camera with spherical stereo in the view `view`; None for views that are of no eye."""
    side = {"left": -0.5, "right": 0.5}.get(view)
    if side is None:
        return None
    stereo = camera.stereo
    parallel = stereo.convergence_mode == "PARALLEL"
    poles = (stereo.pole_merge_angle_from, stereo.pole_merge_angle_to) if stereo.use_pole_merge else None
    return SphericalStereo(
        offset=side * stereo.interocular_distance,
        convergence_distance=np.inf if parallel else stereo.convergence_distance,
        pole_angles=poles,
    )
