"""Volumes of a scene on its device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ...errors import SceneError
from ...programs.inputs_data import upload_inputs
from ...programs.table import store_programs, upload_programs
from ...scene.description import Camera, CameraKind, ClosureKind, Mesh, Scene
from ...scene.features import SceneFeatures, narrow, scene_volumes
from ...scene.geometry import Geometry
from ...shading.bsdf.materials import ClosureRecord, fill_record
from ...shading.images.textures import ImageTable
from ..scene.unchanged import Last, bounds_key
from .bounds import RAYS, FoundBounds, bounded_volumes, find_bounds
from .features import VolumeFeatures
from .grids import GridCache, density_scale, upload_grids
from .kernels import launch_bound
from .table import Enclosure, VolumeData

# The world's volume is taken to be like this many sizes of the scene around it
_WORLD_SIZES = 2.0


@dataclass
class UploadedVolumes:
    """The volumes of a scene, and what keeps them in memory."""

    data: VolumeData
    meshes: list[wp.Mesh]
    grids: list[wp.Volume]
    stored: list[wp.array]


class VolumeCache:
    """What is kept of the volumes of the last frame."""

    def __init__(self) -> None:
        self.grids = GridCache()
        self.bounds: Last[FoundBounds | None] = Last()

    @property
    def device_bytes(self) -> int:
        """Memory that it takes on the device [bytes]."""
        return self.grids.device_bytes + (self.bounds.made.device_bytes if self.bounds.made else 0)

    def clear(self) -> None:
        """Forget it."""
        self.grids.clear()
        self.bounds.clear()


def upload_volumes(
    scene: Scene,
    features: SceneFeatures,
    shading: SceneFeatures,
    geometry: Geometry,
    images: ImageTable,
    device: wp.Device,
    cache: VolumeCache,
) -> UploadedVolumes:
    """All volumes of `scene`, for kernels that are specialised on `shading`, with what `cache` has of them. Raises
    `SceneError` for a coefficient that is negative or not finite.
    """
    volumes = scene_volumes(scene)
    data = VolumeData()
    data.volume_count = len(volumes)
    data.world = len(volumes) - 1 if scene.world.volume is not None else -1
    data.bounce_max = 0
    if len(scene.instances) * len(volumes) >= 2**31 - 1:
        raise SceneError(f"{len(scene.instances):,} instances with {len(volumes):,} volumes are too many to number")
    has_volume = np.array([material.volume is not None for material in scene.materials], bool)
    volume_of = np.where(has_volume, np.cumsum(has_volume) - 1, -1).astype(np.int32)
    data.volume_of = wp.array(volume_of, dtype=int, device=device)
    is_boundary = [_is_boundary(material) for material in scene.materials]
    data.is_boundary = wp.array(np.array(is_boundary, np.int32), dtype=int, device=device)
    closures = [closure for volume in volumes for closure in volume.closures]
    for closure in closures:
        if not np.isfinite(closure.weight).all() or min(closure.weight) < 0:
            raise SceneError("a volume has a coefficient that is negative, infinite or not a number")
    records = np.zeros(len(closures), ClosureRecord.numpy_dtype())
    for record, closure in zip(records, closures):
        fill_record(record, closure)
    data.closures = wp.array(records, dtype=ClosureRecord, device=device)
    first = np.cumsum([0] + [len(volume.closures) for volume in volumes], dtype=np.int32)
    data.closure_first = wp.array(first, dtype=int, device=device)
    programs = [volume.program for volume in volumes]
    grids = []
    if features.volume_program:
        inputs = upload_inputs(scene, features.volume_program.ops, device)
        grids = upload_grids(scene, inputs, device, cache.grids)
        data.nodes = upload_programs(programs, features.volume_program, scene, geometry, images, device, inputs)
    else:
        cache.grids.clear()
    stored = store_programs(data.nodes, device=device) if shading.volume_program.apart else []
    scale = density_scale(scene)
    if scale is not None:
        data.density_scale = wp.array(scale, dtype=float, device=device)
    data.enclosures, meshes = _enclosures(scene, volume_of, device)
    _bound(data, scene, narrow(shading, VolumeFeatures), volume_of, device, features.volume_program.ops, cache.bounds)
    return UploadedVolumes(data, meshes, grids, stored)


def _is_boundary(material) -> bool:
    """Whether a surface is seen by nothing but its volume: it lets all light pass."""
    passes = [c for c in material.closures if c.kind == ClosureKind.TRANSPARENT and c.weight == (1.0, 1.0, 1.0)]
    return material.volume is not None and material.program is None and len(passes) == len(material.closures) == 1


def _bound(
    data: VolumeData,
    scene: Scene,
    features: VolumeFeatures,
    volume_of: np.ndarray,
    device: wp.Device,
    ops: tuple[str, ...],
    kept: Last[FoundBounds | None],
) -> None:
    has_program = [volume.program is not None for volume in scene_volumes(scene)]
    if not any(has_program):
        kept.clear()
        return
    box = _world_box(scene)
    bounded = bounded_volumes(scene, volume_of, has_program, box)
    numbers = np.full(max(len(scene.instances), 1) * data.volume_count, -1, np.int32)
    for number, each in enumerate(bounded):
        if each.instance >= 0:
            numbers[each.instance * data.volume_count + each.volume] = number
        else:
            data.world_bounds = number
    data.bounds_of = wp.array(numbers, dtype=int, device=device)
    rays = RAYS if "light_path" in ops else 1

    def launch(asked: VolumeData, count: int) -> None:
        launch_bound(features, asked, count, device)

    def find() -> FoundBounds | None:
        return find_bounds(data, bounded, launch, device, rays)

    found = kept.get(bounds_key(scene, volume_of, ops, box, device.alias), find)
    if found:
        data.grids, data.bounds = found.grids, found.bounds


def _world_box(scene: Scene) -> np.ndarray:
    """A box around all surfaces, lights and the camera, larger than they are; float64, shape [2, 3]."""
    corners = [np.asarray(scene.camera.transform, np.float64)[:, 3]]
    corners += [np.asarray(light.transform, np.float64)[:, 3] for light in scene.lights]
    boxes = np.array([_places(mesh) for mesh in scene.meshes]).reshape(-1, 3, 8)
    filled = np.array([len(mesh.positions) > 0 for mesh in scene.meshes], bool)
    for index in np.unique(scene.instances.mesh):
        if filled[index]:
            transform = np.asarray(scene.instances.transform, np.float64)[scene.instances.mesh == index]
            placed = transform[:, :, :3] @ boxes[index] + transform[:, :, 3:]
            corners += [placed.min((0, 2)), placed.max((0, 2))]
    box = np.stack([np.min(corners, 0), np.max(corners, 0)])
    middle, half = box.mean(0), np.maximum(np.ptp(box, axis=0).max() / 2, 1.0)
    return np.stack([middle - _WORLD_SIZES * half, middle + _WORLD_SIZES * half])


def _places(mesh: Mesh) -> np.ndarray:
    """Corners of the box of a mesh, shape [3, 8]; 0 where it is empty."""
    if not len(mesh.positions):
        return np.zeros((3, 8))
    return np.array(np.meshgrid(*zip(mesh.positions.min(0), mesh.positions.max(0)))).reshape(3, 8)


def _enclosures(scene: Scene, volume_of: np.ndarray, device: wp.Device) -> tuple[wp.array, list[wp.Mesh]]:
    """Surfaces of volumes that may be around points from which the camera looks."""
    origin, reach = _camera_points(scene.camera)
    volume_count = len(scene_volumes(scene))
    rows, meshes = [], []
    slot_counts: dict[int, int] = {}  # by mesh
    instances = scene.instances
    for instance, mesh_index in enumerate(instances.mesh.tolist()):
        mesh = scene.meshes[mesh_index]
        if len(mesh.triangles) == 0 or mesh.radii is not None:
            continue
        first = int(instances.slot_first[instance])
        if mesh_index not in slot_counts:
            slot_counts[mesh_index] = 1 if mesh.triangle_slot is None else int(mesh.triangle_slot.max()) + 1
        if (volume_of[scene.slot_materials[first : first + slot_counts[mesh_index]]] < 0).all():
            continue
        slot = np.zeros(len(mesh.triangles), int) if mesh.triangle_slot is None else mesh.triangle_slot
        material = scene.slot_materials[int(instances.slot_first[instance]) + slot]
        found = sorted({int(volume_of[m]) for m in np.unique(material)} - {-1})
        if not found:
            continue
        transform = np.asarray(instances.transform[instance], np.float64)
        positions = mesh.positions @ transform[:, :3].T + transform[:, 3]
        if (positions.min(0) > origin + reach).any() or (positions.max(0) < origin - reach).any():
            continue
        for volume in found:
            triangles = mesh.triangles[volume_of[material] == volume]
            if np.linalg.det(transform[:, :3]) < 0:
                triangles = triangles[:, ::-1]  # the front of a mirrored object stays the front
            points = wp.array(positions.astype(np.float32), dtype=wp.vec3, device=device)
            meshes.append(wp.Mesh(points, wp.array(triangles.ravel(), dtype=int, device=device)))
            rows.append((meshes[-1].id, 1 + instance * volume_count + volume))
    table = np.zeros(len(rows), Enclosure.numpy_dtype())
    for row, (mesh_id, code) in zip(table, rows):
        row["mesh"], row["code"] = mesh_id, code
    return wp.array(table, dtype=Enclosure, device=device), meshes


def _camera_points(camera: Camera) -> tuple[np.ndarray, float]:
    """A sphere that holds the origins of all rays of `camera`: its centre and radius [m]."""
    window = float(np.hypot(np.abs(camera.window[:2]).max(), np.abs(camera.window[2:]).max()))
    reach = camera.lens_radius * max(1.0, 1.0 / camera.lens_ratio)
    if camera.kind == CameraKind.ORTHOGRAPHIC:
        reach += window + camera.clip_start
    else:
        reach += camera.clip_start * float(np.hypot(1.0, window))
    return np.asarray(camera.transform, np.float64)[:, 3], reach
