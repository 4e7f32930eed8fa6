"""A scene on a device: everything that kernels read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from ..bvh.reference import ReferenceTree
from ..bvh.tree import Tree
from ..bvh.treelet_tree import TreeletTree
from ..scene.description import ClosureKind, Scene
from ..scene.features import SceneFeatures
from ..scene.geometry import Geometry
from ..shading.camera import CameraData, upload_camera
from ..shading.closures import ClosureFeatures, MaterialTable, upload_materials
from ..shading.nodes.op import NodeData
from ..shading.nodes.table import upload_programs
from ..shading.light_table import LightTable, UploadedLights, upload_lights
from .geometry_cache import BuiltGeometry, GeometryCache, GeometryRequest, PagedTree
from .tracing import Tracing


@wp.struct
class SceneData:
    """What shading reads."""

    geometry: Geometry
    materials: MaterialTable
    nodes: NodeData  # of shader programs; empty where there are none
    lights: LightTable
    world: wp.vec3  # radiance of the world [W/(m² sr)]
    world_visibility: int
    view_origin: wp.vec3  # of the camera, for depth
    view_axis: wp.vec3


@dataclass
class DeviceScene:
    """A scene ready to render; shared by all workers, which only read it."""

    device: wp.Device
    features: SceneFeatures
    data: SceneData
    camera: CameraData
    tree: Tree | ReferenceTree | None  # None: there is nothing to hit
    tracing: Tracing
    treelets: TreeletTree | None  # where rays wait at treelets in memory
    box: np.ndarray | None  # two corners that hold all surfaces [m], float64, shape [2, 3]
    transparent_shadows: bool  # some surface lets shadow rays through
    lights: UploadedLights  # keeps the tree of the lights alive
    shadow_rays: bool  # there is an emitter to aim at, not only code for it
    built: BuiltGeometry | None

    @staticmethod
    def build(scene: Scene, features: SceneFeatures, request: GeometryRequest, device: wp.Device, cache: GeometryCache) -> DeviceScene:
        """Upload `scene` and build its tree."""
        data = SceneData()
        built = treelets = None
        if features.surfaces:
            kept = cache.get(scene, request, device)
            data.geometry, built, treelets = kept.geometry, kept.built, kept.treelets
            data.materials = upload_materials(scene.materials, ClosureFeatures(features.closures), device)
            data.nodes = upload_programs(scene, features, data.geometry, device)
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
            Tracing.of(request.plan, request.layout, features), treelets,
            built.box if built else None, lets_through, lights, features.shadow_rays and lights.emitter_count > 0, built,
        )  # fmt: skip

    @property
    def paged(self) -> PagedTree | None:
        """The tree, where it lies beyond memory."""
        return self.built if isinstance(self.built, PagedTree) else None

    @property
    def geometry_on_host(self) -> bool:
        """Whether a CUDA device reads what shading needs of triangles through the bus."""
        return self.paged is not None and self.device.is_cuda
