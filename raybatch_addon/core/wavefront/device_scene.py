"""A scene on a device: everything that kernels read."""

from __future__ import annotations

import dataclasses
import hashlib
import threading
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..bvh.build import BuiltTree, build_scene_tree
from ..bvh.node import Layout
from ..bvh.reference import BuiltReference, ReferenceTree, build_reference
from ..bvh.tree import Tree
from ..scene.description import ClosureKind, Scene
from ..scene.features import SceneFeatures
from ..scene.flatten import flatten
from ..scene.geometry import Geometry, upload_geometry
from ..settings import RenderSettings
from ..shading.camera import CameraData, upload_camera
from ..shading.closures import ClosureFeatures, MaterialTable, upload_materials
from ..shading.light_table import LightTable, UploadedLights, upload_lights
from .stages.trace import Traversal


@wp.struct
class SceneData:
    """What shading reads."""

    geometry: Geometry
    materials: MaterialTable
    lights: LightTable
    world: wp.vec3  # radiance of the world [W/(m² sr)]
    world_visibility: int
    view_origin: wp.vec3  # of the camera, for depth
    view_axis: wp.vec3


@dataclass
class _CachedGeometry:
    key: bytes
    geometry: Geometry
    built: BuiltReference | BuiltTree


class GeometryCache:
    """The geometry and tree of the last scene, for the next frame that shows the same."""

    def __init__(self):
        self._last: _CachedGeometry | None = None
        self._lock = threading.Lock()  # the build of a cancelled render may still be going on

    def clear(self) -> None:
        """Forget it."""
        self._last = None

    def get(
        self, scene: Scene, instancing: bool, settings: RenderSettings, layout: Layout, device: wp.Device
    ) -> tuple[Geometry, BuiltReference | BuiltTree]:
        """Geometry and tree of `scene`, built unless the last scene had the same geometry."""
        flat = flatten(scene)
        visibility = scene.instances.visibility
        digest = hashlib.blake2b(digest_size=20)
        arrays = [getattr(flat, field.name) for field in dataclasses.fields(flat) if field.name != "merged"]
        for array in [*arrays, visibility, scene.instances.slot_first, scene.slot_materials]:
            digest.update(str((array.dtype, array.shape)).encode())
            digest.update(np.ascontiguousarray(array))
        digest.update(repr((instancing, settings.batching, settings.spatial_splits, layout)).encode())
        key = digest.digest()
        with self._lock:
            if self._last is None or self._last.key != key:
                self._last = None  # before the new one is built: never hold two
                geometry = upload_geometry(flat, scene, device)
                if settings.batching == "REFERENCE":
                    built = build_reference(flat, visibility, instancing, device)
                else:
                    built = build_scene_tree(flat, geometry, visibility, instancing, device, layout, settings.spatial_splits == "ON")
                self._last = _CachedGeometry(key, geometry, built)
            return self._last.geometry, self._last.built


@dataclass
class DeviceScene:
    """A scene ready to render; shared by all workers, which only read it."""

    device: wp.Device
    features: SceneFeatures
    data: SceneData
    camera: CameraData
    tree: Tree | ReferenceTree | None  # None: there is nothing to hit
    traversal: Traversal
    box: np.ndarray | None  # two corners that hold all surfaces [m], float64, shape [2, 3]
    transparent_shadows: bool  # some surface lets shadow rays through
    lights: UploadedLights  # keeps the tree of the lights alive
    shadow_rays: bool  # there is an emitter to aim at, not only code for it
    built: BuiltReference | BuiltTree | None

    @staticmethod
    def build(
        scene: Scene, features: SceneFeatures, settings: RenderSettings, layout: Layout, device: wp.Device, cache: GeometryCache
    ) -> DeviceScene:
        """Upload `scene` and build its tree."""
        data = SceneData()
        built = None
        if features.surfaces:
            data.geometry, built = cache.get(scene, features.instancing, settings, layout, device)
            data.materials = upload_materials(scene.materials, ClosureFeatures(features.closures), device)
        lights = upload_lights(scene, device)
        data.lights = lights.table
        data.world = wp.vec3(*scene.world.radiance)
        data.world_visibility = scene.world.visibility
        matrix = np.asarray(scene.camera.transform, np.float64)
        data.view_origin = wp.vec3(*matrix[:, 3].tolist())
        data.view_axis = wp.vec3(*(-matrix[:, 2] / np.linalg.norm(matrix[:, 2])).tolist())
        lets_through = any(
            closure.kind == ClosureKind.TRANSPARENT and any(closure.weight)
            for material in scene.materials
            for closure in material.closures
        )
        return DeviceScene(
            device, features, data, upload_camera(scene.camera, scene.frame.width, scene.frame.height), built.tree if built else None,
            Traversal.of(settings.batching, layout), built.box if built else None, lets_through, lights, features.shadow_rays and lights.emitter_count > 0, built,
        )  # fmt: skip
