"""Stages at the surfaces of volumes: where paths begin, and on which side of a surface they and their shadow rays go
on.
"""

from __future__ import annotations

import functools

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...rays import Rays
from ...shading.segments import make_is_closed, make_surface_point
from ...shading.surface import material_at
from ..rays import Paths, Status, time_of
from ..scene.scene_data import SceneData
from .table import FRONT, VolumeData, across, entered

RAY_NEW, SHADOW_NEW, INSIDE = int(Status.RAY_NEW), int(Status.SHADOW_NEW), int(Status.INSIDE)
# A direction that lies along no axis, in which surfaces around a camera are looked for
_AHEAD = (0.436, 0.218, 0.873)
_FARTHEST = 1e30


@wp.kernel(**KERNEL_OPTIONS)
def enter_kernel(volumes: VolumeData, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
    """New paths: in which volumes they begin. A point is in a closed surface if a ray from it meets the back first."""
    i = wp.tid()
    if i >= count[0]:
        return
    path = slots[i]
    inside = wp.vec4i(0, 0, 0, 0)
    for k in range(volumes.enclosures.shape[0]):
        ahead = wp.normalize(wp.vec3(wp.static(_AHEAD[0]), wp.static(_AHEAD[1]), wp.static(_AHEAD[2])))
        query = wp.mesh_query_ray(volumes.enclosures[k].mesh, rays.origin[path], ahead, wp.static(_FARTHEST))
        if query.result and query.sign < 0.0:
            inside = entered(inside, volumes.enclosures[k].code)
    volumes.state.inside[path] = inside
    volumes.state.segment[path] = 0
    volumes.state.scattered[path] = 0
    volumes.state.side[path] = 0
    volumes.state.lit[path] = 0


@functools.cache
def cross_kernel(instancing: bool, smooth_normals: bool, curves: bool, moving: bool) -> wp.Kernel:
    """Kernel (data, volumes, paths, rays, slots, count): paths that have met a surface, behind the stage there."""
    surface_point = make_surface_point(instancing, smooth_normals, curves, moving)
    is_closed = make_is_closed(curves)

    @wp.kernel(**KERNEL_OPTIONS)
    def cross(
        data: SceneData,
        volumes: VolumeData,
        paths: Paths,
        rays: Rays,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
    ):
        i = wp.tid()
        if i >= count[0]:
            return
        path = slots[i]
        side = volumes.state.side[path]
        status = paths.status[path]
        if side == 0 or (status & wp.static(RAY_NEW | SHADOW_NEW)) == 0:
            return
        instance = rays.hit_instance[path]
        material = material_at(data.geometry, instance, rays.hit_primitive[path])
        if volumes.volume_of[material] < 0:  # the same volumes are on both sides
            if (status & wp.static(SHADOW_NEW)) != 0:
                volumes.state.shadow_inside[path] = volumes.state.inside[path]
                volumes.state.shadow_segment[path] = 0
            return
        surface = surface_point(
            data.geometry, instance, rays.hit_primitive[path], rays.hit_uv[path], time_of(rays, path)
        )
        normal = surface.geometric_normal
        if side != wp.static(FRONT):
            normal = -normal
        inside = volumes.state.inside[path]
        behind = inside
        if is_closed(data.geometry, instance, rays.hit_primitive[path]):
            behind = across(volumes, inside, instance, material, side)
        if (status & wp.static(SHADOW_NEW)) != 0:
            goes_behind = wp.dot(rays.direction[paths.status.shape[0] + path], normal) < 0.0
            volumes.state.shadow_inside[path] = wp.where(goes_behind, behind, inside)
            volumes.state.shadow_segment[path] = 0
        # a step of a walk below the surface is in that medium alone, and comes out here again
        if (status & wp.static(RAY_NEW)) != 0 and (status & wp.static(INSIDE)) == 0:
            if wp.dot(rays.direction[path], normal) < 0.0:
                volumes.state.inside[path] = behind
                if volumes.is_boundary[material] != 0:
                    paths.passed[path] = paths.passed[path] - 1  # nobody sees such a surface

    return cross
