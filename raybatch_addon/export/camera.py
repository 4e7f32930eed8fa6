"""Blender's camera as the core's `Camera`, framed as Blender frames it."""

from __future__ import annotations

import functools
from typing import Literal, NamedTuple

import bpy
import numpy as np

from ..core.errors import SceneError
from ..core.scene.description import Camera, CameraKind
from ..core.scene.notice import Notice, Weight
from .panorama import export_panorama, export_stereo, panorama_kind
from .view import View

# Smallest f-number of Cycles, which keeps the aperture finite
_FSTOP_MIN = 1e-5


def no_camera(scene: str) -> str:
    """What the user is told where the scene of this name has no camera."""
    return f"scene “{scene}” has no camera; add one (Add > Camera) and make it the scene's active camera"


def export_camera(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    width: int,
    height: int,
    warnings: list[str],
    view: View = View(),
) -> Camera:
    """The active camera of `scene` for a full frame of `width` x `height` pixels, as `view` has it.

    Raises `SceneError` if there is no camera, if the object is no camera, for a matrix that is singular or not finite,
    and for clipping that leaves nothing.
    """
    active = view.camera(scene)
    if active is None:
        raise SceneError(no_camera(scene.name))
    obj = active.evaluated_get(depsgraph)
    if obj.type != "CAMERA":
        kind = obj.type.lower()
        raise SceneError(
            f"the active camera “{obj.name}” of scene “{scene.name}” is a {kind}; make a camera the active one"
        )
    camera = obj.data
    name = f"camera “{obj.name}”"
    kind = kind_of(camera, name, warnings)
    spherical = kind != CameraKind.ORTHOGRAPHIC and view.is_spherical(obj)
    transform = _transform(view.matrix(obj, spherical), name)
    if camera.clip_end <= camera.clip_start:
        raise SceneError(
            f"{name}: its clip end ({camera.clip_end:g}) is not beyond its clip start ({camera.clip_start:g}); raise it"
        )
    return Camera(
        kind=kind,
        transform=transform,
        window=frame_window(camera, kind, view.shift(obj, spherical), scene.render, width, height),
        clip_start=float(camera.clip_start),
        clip_end=float(camera.clip_end),
        **depth_of_field(obj, kind, transform, depsgraph, name, warnings),
        panorama=export_panorama(camera, _span(scene.render, width, height)) if kind.is_panorama else None,
        stereo=export_stereo(camera, view.name) if spherical else None,
    )


def kind_of(camera: bpy.types.Camera, name: str, warnings: list[str]) -> CameraKind:
    """The projection of `camera`, which messages call `name`."""
    if camera.type == "PANO":
        return panorama_kind(camera, name, warnings)
    if camera.type not in ("PERSP", "ORTHO"):
        text = f"{name}: {_type_label(camera)} cameras are not supported; it is rendered as a perspective camera"
        warnings.append(Notice(text, Weight.MISSING, remedy="choose another type in the camera's Lens panel"))
    return CameraKind.ORTHOGRAPHIC if camera.type == "ORTHO" else CameraKind.PERSPECTIVE


def _transform(matrix: np.ndarray, name: str) -> np.ndarray:
    """Camera to world without scale, as Blender views through the camera, from its matrix [4, 4]: shape [3, 4]."""
    if not np.isfinite(matrix).all():
        raise SceneError(f"{name}: its matrix is not finite; reset its location, rotation and scale")
    found = _without_scale(MatrixKey.of(matrix))
    if found is None:
        raise SceneError(f"{name}: its matrix is singular; give it, and what it is parented to, a scale that is not 0")
    return found.copy("K")


class MatrixKey(NamedTuple):
    """A matrix of 4 x 4 as a key of what is made of it, which renders ask for again."""

    numbers: bytes  # float64
    order: Literal["C", "F"]  # of its memory, which sums may follow: row by row, or column by column

    @classmethod
    def of(cls, matrix: np.ndarray) -> MatrixKey:
        """That of `matrix`."""
        return cls(np.asarray(matrix, float).tobytes("A"), "F" if matrix.flags.f_contiguous else "C")

    def matrix(self) -> np.ndarray:
        """The matrix, float64, shape [4, 4]; read-only."""
        return np.frombuffer(self.numbers).reshape((4, 4), order=self.order)


@functools.lru_cache(maxsize=256)
def _without_scale(key: MatrixKey) -> np.ndarray | None:
    """The matrix with axes of unit length, shape [3, 4]; None where it is singular."""
    numbers = key.matrix()
    scale = np.linalg.norm(numbers[:3, :3], axis=0)
    axes = numbers[:3, :3] / np.where(scale > 0, scale, 1)
    # axes of unit length span a volume of 1, less where they are sheared
    if abs(np.linalg.det(axes)) < np.finfo(np.float32).eps:
        return None
    return np.column_stack([axes, numbers[:3, 3]]).astype(np.float32)


def _span(render: bpy.types.RenderSettings, width: int, height: int) -> np.ndarray:
    """Width and height of the frame, in pixels of no aspect: shape [2]."""
    return np.array([width * render.pixel_aspect_x, height * render.pixel_aspect_y])


def frame_window(
    camera: bpy.types.Camera,
    kind: CameraKind,
    shift: tuple[float, float],
    render: bpy.types.RenderSettings,
    width: int,
    height: int,
) -> tuple[float, float, float, float]:
    """Left, right, bottom, top edges of the frame, as `Camera.window` has them."""
    if kind.is_panorama:
        return shift[0], shift[0] + 1, shift[1], shift[1] + 1
    span = _span(render, width, height)
    fit = camera.sensor_fit
    along = {"HORIZONTAL": 0, "VERTICAL": 1}.get(fit, int(span[1] > span[0]))
    if kind == CameraKind.ORTHOGRAPHIC:
        extent = camera.ortho_scale
    else:
        extent = (camera.sensor_height if fit == "VERTICAL" else camera.sensor_width) / camera.lens
    # the sensor's extent lies along the axis of the fit; shift is in units of it on both axes
    half = extent / 2 * span / span[along]
    centre = np.array(shift) * extent
    left, bottom = (float(edge) for edge in centre - half)
    right, top = (float(edge) for edge in centre + half)
    return left, right, bottom, top


def depth_of_field(obj, kind: CameraKind, transform: np.ndarray, depsgraph, name: str, warnings: list[str]) -> dict:
    """The fields of `Camera` that say what the camera object is sharp for; none where all is sharp."""
    camera = obj.data
    if not camera.dof.use_dof:
        return {}
    distance = _focus_distance(camera, transform, depsgraph)
    if not np.isfinite(distance) or distance <= 0:
        warnings.append(
            Notice(
                f"{name}: its focus distance is {distance:g}, where nothing can be sharp; depth of field is left out",
                Weight.REPAIRED,
                objects=[obj.name],
                remedy="set a focus distance above 0, or another focus object",
            )
        )
        return {}
    # a focal length in millimetres over twice the f-number; an orthographic camera counts as a focal length of one
    # metre
    focal_length = 1.0 if kind == CameraKind.ORTHOGRAPHIC else camera.lens * 1e-3
    return dict(
        lens_radius=focal_length / (2 * max(camera.dof.aperture_fstop, _FSTOP_MIN)),
        focus_distance=float(distance),
        blade_count=int(camera.dof.aperture_blades),
        blade_rotation=float(camera.dof.aperture_rotation),
        lens_ratio=float(camera.dof.aperture_ratio),
    )


def _focus_distance(camera: bpy.types.Camera, transform: np.ndarray, depsgraph) -> float:
    """Distance of the sharp plane along the view axis [m], to the focus object or its bone where there is one."""
    target = camera.dof.focus_object
    if target is None:
        return float(camera.dof.focus_distance)
    target = target.evaluated_get(depsgraph)
    matrix = target.matrix_world
    bone = target.pose.bones.get(camera.dof.focus_subtarget) if target.pose and camera.dof.focus_subtarget else None
    if bone is not None:
        matrix = matrix @ bone.matrix
    return abs(float((np.array(matrix.translation) - transform[:, 3]) @ transform[:, 2]))


def _type_label(camera: bpy.types.Camera) -> str:
    items = camera.bl_rna.properties["type"].enum_items
    return items[camera.type].name.lower() if camera.type in items else camera.type.lower()
