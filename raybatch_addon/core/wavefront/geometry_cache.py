"""What is kept of a scene's geometry and tree for the next frame."""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..bvh.build import BuiltTree, build_scene_tree, refit_scene_tree, splits_triangles
from ..bvh.memory import GeometrySize, check_counts, check_memory, memory_told
from ..bvh.mesh_tree import mesh_parts
from ..bvh.node import Layout
from ..bvh.reference import BuiltReference, build_reference
from ..scene.description import Scene
from ..scene.flatten import FlatGeometry, flatten
from ..scene.geometry import Geometry, update_geometry, upload_geometry
from ..settings import RenderSettings


@dataclass(frozen=True)
class _Fingerprint:
    """Digests of a frame: what is equal was equal."""

    topology: bytes  # triangles, what instances place, visibility, settings: a tree can follow only where it is the same
    positions: tuple[bytes, ...]  # of each mesh tree
    transforms: bytes  # of instances that are not baked
    surface: bytes  # normals and materials, which trees do not know

    @staticmethod
    def of(flat: FlatGeometry, scene: Scene, kind: tuple) -> _Fingerprint:
        """Of a frame; `kind` are the choices that its tree depends on."""
        merged = [array for group in flat.merged for array in (group.instance, group.instance_triangle_first)]
        topology = [
            flat.triangles, flat.mesh_triangle_first, flat.mesh_vertex_first, flat.instance_mesh, flat.shared, *merged,
            scene.instances.visibility, np.frombuffer(repr(kind).encode(), np.uint8),
        ]  # fmt: skip
        parts = [flat.positions[part.vertex_first : part.vertex_first + part.vertex_count] for part in mesh_parts(flat)]
        surface = [flat.corner_normals, flat.triangle_slot, scene.instances.slot_first, scene.slot_materials]
        return _Fingerprint(_digest(topology), tuple(_digest([part]) for part in parts), _digest([flat.instance_transform]), _digest(surface))


def _digest(arrays: Iterable[np.ndarray]) -> bytes:
    """Equal for equal arrays only."""
    digest = hashlib.sha1(usedforsecurity=False)  # twice as fast as others where processors have instructions for it
    for array in arrays:
        digest.update(str((array.dtype, array.shape)).encode())
        digest.update(np.ascontiguousarray(array))
    return digest.digest()


@dataclass
class _Kept:
    fingerprint: _Fingerprint
    geometry: Geometry
    built: BuiltReference | BuiltTree


class GeometryCache:
    """The geometry and tree of the last frame, for the next one: kept where it shows the same, refitted where things only moved."""

    def __init__(self):
        self._last: _Kept | None = None
        self._lock = threading.Lock()  # the build of a cancelled render may still be going on

    def clear(self) -> None:
        """Forget it."""
        self._last = None

    def get(
        self, scene: Scene, instancing: bool, settings: RenderSettings, layout: Layout, device: wp.Device
    ) -> tuple[Geometry, BuiltReference | BuiltTree]:
        """Geometry and tree of `scene`; those of the last call cannot be used any more.

        Raises `SceneError` for too large a scene, `OutOfMemoryError` for one that does not fit, before or where memory is asked for.
        """
        size = GeometrySize.of(scene)
        check_counts(size)
        check_memory(size, layout, device, all_of_it=True)
        with memory_told(size, layout, device):
            return self._get(scene, size, instancing, settings, layout, device)

    def _get(
        self, scene: Scene, size: GeometrySize, instancing: bool, settings: RenderSettings, layout: Layout, device: wp.Device
    ) -> tuple[Geometry, BuiltReference | BuiltTree]:
        flat = flatten(scene)
        fingerprint = _Fingerprint.of(flat, scene, (instancing, settings.batching, settings.spatial_splits, layout))
        with self._lock:
            # nothing is kept until the new one is whole: not what an error left half done, nor two of them
            last, self._last = self._last, None
            if last is None or not _follow(last, fingerprint, flat, scene, device):
                del last
                check_memory(size, layout, device, all_of_it=False)
                last = _build(fingerprint, flat, scene, instancing, settings, layout, device)
            self._last = last
            return last.geometry, last.built


def _follow(last: _Kept, fingerprint: _Fingerprint, flat: FlatGeometry, scene: Scene, device: wp.Device) -> bool:
    """Make `last` show the frame; False where it cannot."""
    start = time.perf_counter()
    before, last.fingerprint = last.fingerprint, fingerprint
    own = isinstance(last.built, BuiltTree)
    if fingerprint != before:
        if not own or fingerprint.topology != before.topology:
            return False
        update_geometry(last.geometry, flat, scene)
        moved = [i for i, (old, new) in enumerate(zip(before.positions, fingerprint.positions, strict=True)) if old != new]
        if moved or fingerprint.transforms != before.transforms:
            refit_scene_tree(last.built, flat, last.geometry, scene.instances.visibility, moved, device)
            return True
    if own:
        last.built.tell(0, 0, start)
    return True


def _build(
    fingerprint: _Fingerprint, flat: FlatGeometry, scene: Scene, instancing: bool, settings: RenderSettings, layout: Layout, device: wp.Device
) -> _Kept:
    geometry, visibility = upload_geometry(flat, scene, device), scene.instances.visibility
    if settings.batching == "REFERENCE":
        return _Kept(fingerprint, geometry, build_reference(flat, visibility, instancing, device))
    splits = splits_triangles(settings.spatial_splits, layout)
    return _Kept(fingerprint, geometry, build_scene_tree(flat, geometry, visibility, instancing, device, layout, splits, settings.spatial_splits == "ON"))
