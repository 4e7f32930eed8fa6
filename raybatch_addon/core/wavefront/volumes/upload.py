"""Volumes of a scene on its device."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...displacement.boundaries import is_boundary
from ...errors import SceneError
from ...programs.inputs_data import upload_inputs
from ...programs.op import op_named
from ...programs.table import store_programs, upload_programs
from ...scene.description import ClosureKind, Mesh, Scene, Volume
from ...scene.features import SceneFeatures, narrow, scene_volumes
from ...scene.geometry import Geometry
from ...scene.motion import apart
from ...shading.bsdf.materials import ClosureRecord, fill_record
from ...shading.images.textures import ImageTable
from ...shading.lights.emitters import EmissiveCells
from ...shading.volumes.enclosures import upload_enclosures
from ...shading.volumes.overlaps import crowded_volumes, volume_numbers
from ...shading.volumes.portals import portals_in_volumes
from ..scene.unchanged import Last, bounds_key
from .bounds import RAYS, FoundBounds, bounded_volumes, find_bounds, goes_on_beyond
from .emission.cells import FoundCells, find_cells, has_owners
from .features import VolumeFeatures
from .grids import GridCache, density_scale, upload_flows, upload_grids
from .kernels import launch_bound
from .medium import WORLD_REACH, may_vary
from .table import VolumeData

# Ops of closures that scatter nothing
_UNSCATTERED = ("emission", "volume_absorption")
# The world's volume is taken to be like this many sizes of the scene around it
_WORLD_SIZES = 2.0


@dataclass
class UploadedVolumes:
    """The volumes of a scene, and what keeps them in memory."""

    data: VolumeData
    surfaces: list[wp.Bvh]
    grids: list[wp.Volume]
    stored: list[wp.array]
    warnings: list[str]  # where less of them is rendered than there is
    cells: EmissiveCells | None = None  # their light, where it is aimed at


class VolumeCache:
    """Volumes of the last frame, kept for the next one."""

    def __init__(self) -> None:
        self.grids = GridCache()
        self.bounds: Last[FoundBounds | None] = Last()
        self.cells: Last[FoundCells | None] = Last()

    @property
    def device_bytes(self) -> int:
        """Memory that it takes on the device [bytes]."""
        return self.grids.device_bytes + (self.bounds.made.device_bytes if self.bounds.made else 0)

    def clear(self) -> None:
        """Forget it."""
        self.grids.clear()
        self.bounds.clear()
        self.cells.clear()


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
    volume_of = volume_numbers(scene)
    data.volume_of = wp.array(volume_of, dtype=int, device=device)
    seen_by_volume = [is_boundary(material) for material in scene.materials]
    data.is_boundary = wp.array(np.array(seen_by_volume, np.int32), dtype=int, device=device)
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
        grids += upload_flows(scene, data, device, cache.grids)
        data.nodes = upload_programs(programs, features.volume_program, scene, geometry, images, device, inputs)
    else:
        cache.grids.clear()
    stored = store_programs(data.nodes, device=device) if shading.volume_program.apart else []
    scale = density_scale(scene)
    if scale is not None:
        data.density_scale = wp.array(scale, dtype=float, device=device)
    enclosures = upload_enclosures(scene, volume_of, data.volume_count, geometry, device)
    data.enclosures = enclosures.data
    data.varies = int(may_vary(features.volume_program))
    data.scatters = int(not features.volume_lights or any(map(_may_scatter, volumes)))
    ops, asked = features.volume_program.ops, narrow(shading, VolumeFeatures)
    key = bounds_key(scene, volume_of, ops, device.alias) if data.varies or features.volume_lights else ([], ())
    warnings = _bound(data, scene, asked, volume_of, device, ops=ops, key=key, kept=cache.bounds)
    found = crowded_volumes(scene) + portals_in_volumes(scene)
    warnings += [each for each in found if each not in scene.warnings]
    cells = None
    if features.volume_lights:
        cells = _emission(data, scene, asked, volume_of, device, key=key, kept=cache.cells)
    else:
        cache.cells.clear()
    return UploadedVolumes(data, enclosures.kept, grids, stored, warnings, cells)


def _may_scatter(volume: Volume) -> bool:
    made = () if volume.program is None else volume.program.instructions
    by_program = any(op_named(step.op).makes_closures and step.op not in _UNSCATTERED for step in made)
    return by_program or any(closure.kind > ClosureKind.VOLUME_ABSORPTION for closure in volume.closures)


def _emission(
    data: VolumeData,
    scene: Scene,
    features: VolumeFeatures,
    volume_of: np.ndarray,
    device: wp.Device,
    key: tuple[list[np.ndarray | None], tuple],
    kept: Last[FoundCells | None],
) -> EmissiveCells | None:
    """The cells of `scene` in which volumes emit, or those that are `kept`; what kernels read of them is written to
    `data`. `key`: of the bounds.
    """
    arrays, values = key
    links = scene.instances.links
    seen = scene.instances.visibility.tobytes(), apart(scene).tobytes(), None if links is None else links.tobytes()
    owned = has_owners(scene)
    closures = tuple(volume.closures for volume in scene_volumes(scene))
    found = kept.get(
        (arrays, (values, closures, seen, owned)),
        lambda: find_cells(
            data, scene, volume_of, lambda asked, count: launch_bound(features, asked, count, device), device
        ),
    )
    if found is None:
        return None
    data.lights = found.upload(len(scene.lights), device)
    return found.cells


def _bound(
    data: VolumeData,
    scene: Scene,
    features: VolumeFeatures,
    volume_of: np.ndarray,
    device: wp.Device,
    ops: tuple[str, ...],
    key: tuple[list[np.ndarray | None], tuple],
    kept: Last[FoundBounds | None],
) -> list[str]:
    """Find the bounds of programs that vary, or take those that are `kept`; what of their volumes is not rendered.
    `key`: what they follow from, but for the world's box.
    """
    has_program = [volume.program is not None for volume in scene_volumes(scene)]
    if not data.varies:
        kept.clear()
        return []
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
        found = find_bounds(data, bounded, launch, device, rays)
        if found and data.world >= 0 and has_program[-1]:
            found = dataclasses.replace(found, goes_on=goes_on_beyond(data, box, launch, device))
        return found

    arrays, values = key
    found = kept.get((arrays, (values, box.tobytes() if has_program[-1] and data.world >= 0 else None)), find)
    if not found:
        return []
    data.grids, data.bounds = found.grids, found.bounds
    names = [f"material “{each.name}”" for each in scene.materials if each.volume is not None] + ["the world"]
    denser: dict[int, float] = {}  # by volume
    for each, limit in zip(bounded, found.most):
        if np.isfinite(limit):
            denser[each.volume] = min(limit, denser.get(each.volume, np.inf))
    warnings = [
        f"{names[volume]}: its volume is denser than {limit:.3g} per metre, and is rendered as dense as that"
        for volume, limit in sorted(denser.items())
    ]
    if found.goes_on:
        end = (0.5 + WORLD_REACH) * float((box[1] - box[0]).min())
        warnings.append(f"the world: its volume ends {end:.3g} m from the middle of the scene; beyond is no fog")
    return warnings


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
