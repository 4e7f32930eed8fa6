"""A request for a scene's geometry, and what of the scene geometry and tree follow from."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import warp as wp

from ...bvh.build.in_common import TreesInCommon
from ...bvh.node import Layout
from ...bvh.pages.peers.shared import PeerPages
from ...device.bulk import digest_of
from ...host_memory import Room, mapped_empty
from ...scene.description import Scene
from ...settings.settings import RenderSettings
from ..plan.plan import Method, TracingPlan, cut_rule


@dataclass(frozen=True)
class GeometryInCommon:
    """What a device has of geometry that several devices of a render get ready together."""

    trees: TreesInCommon | None = None  # where there are others
    pages: PeerPages | None = None  # its part, where they hold pages for each other


@dataclass(frozen=True, kw_only=True)
class GeometryRequest:
    """A request for a scene's geometry."""

    settings: RenderSettings
    plan: TracingPlan
    layout: Layout
    instancing: bool  # as the kernels that shade (`SceneFeatures.instancing`)
    page_folder: Path  # for geometry that lies on disk
    common: GeometryInCommon = GeometryInCommon()
    cancelled: Callable[[], bool] = lambda: False  # asked on any thread while pages are built, which it ends

    def room(self, device: wp.Device) -> Room:
        """Where arrays of all geometry lie: on the disk too where that is what is behind the memory of a CPU."""
        if device.is_cpu and self.plan.method is Method.PAGED and self.plan.geometry_store == "DISK":
            return functools.partial(mapped_empty, folder=self.page_folder)
        return np.empty

    def kind(self) -> tuple:
        """The choices that a tree depends on."""
        plan = self.plan
        paged = (
            (
                plan.geometry_budget,
                plan.geometry_store,
                cut_rule(plan, self.settings),
                self.common.pages.kind if self.common.pages else (),
            )
            if plan.method is Method.PAGED
            else ()
        )
        return (self.instancing, plan.method is Method.REFERENCE, self.settings.spatial_splits, self.layout, *paged)


def geometry_of(scene: Scene, request: GeometryRequest) -> tuple[list[np.ndarray | None], tuple]:
    """Arrays and values that geometry, tree and treelets of `scene` follow from."""
    arrays, values = still_of(scene, request)
    instances = scene.instances
    placed = digest_of(
        [instances.mesh, instances.transform, instances.visibility, instances.slot_first]
        + ([] if instances.motion is None else [instances.motion.instance, instances.motion.maps])
    )
    return arrays, (placed, *values)


def still_of(scene: Scene, request: GeometryRequest) -> tuple[list[np.ndarray | None], tuple]:
    """The same, but for what its instances are."""
    meshes = [
        array
        for mesh in scene.meshes
        for array in (
            mesh.positions,
            mesh.triangles,
            mesh.triangle_slot,
            mesh.corner_normals,
            mesh.radii,
            mesh.motion,
            mesh.motion_normals,
        )
    ]
    cut = cut_rule(request.plan, request.settings) if request.plan.method is Method.BATCHED else None
    ribbons = tuple(mesh.ribbons for mesh in scene.meshes)
    return meshes, (digest_of([scene.slot_materials]), ribbons, request.kind(), request.plan.method, cut)
