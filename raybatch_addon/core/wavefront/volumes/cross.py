"""Stages at the surfaces of volumes: where paths begin, and on which side of a surface they and their shadow rays go
on.
"""

from __future__ import annotations

import functools

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...rays import Rays
from ...scene.geometry import Geometry
from ...shading.segments import make_is_closed, make_surface_point
from ...shading.surface import SurfacePoint, material_at, spawn_origin
from ...shading.volumes.enclosures import NEAR_MOST, enclosures_near, is_around, passed_at_once
from ..rays import Paths, Status, time_of
from ..scene.shading_data import SceneData
from .table import BACK, FRONT, VolumeData, across, entered, holds, left

_RAY_NEW, _SHADOW_NEW, _INSIDE = int(Status.RAY_NEW), int(Status.SHADOW_NEW), int(Status.INSIDE)


@wp.kernel(**KERNEL_OPTIONS)
def enter_kernel(
    geometry: Geometry, volumes: VolumeData, rays: Rays, slots: wp.array(dtype=int), count: wp.array(dtype=int)
):
    """New paths: in which volumes they begin, where and when they do."""
    i = wp.tid()
    if i >= count[0]:
        return
    path = slots[i]
    inside = wp.vec4i(0, 0, 0, 0)
    if volumes.enclosures.of.shape[0] > 0:
        origin = rays.origin[path]
        near = wp.zeros(wp.static(NEAR_MOST), dtype=int)
        count_near = enclosures_near(volumes.enclosures, origin, origin, -1, near)
        while count_near > 0:
            for n in range(count_near):
                if is_around(geometry, volumes.enclosures, near[n], origin, time_of(rays, path)):
                    inside = entered(inside, volumes.enclosures.of[near[n]].code)
            count_near = enclosures_near(volumes.enclosures, origin, origin, near[count_near - 1], near)
    volumes.state.inside[path] = inside
    volumes.state.segment[path] = 0
    volumes.state.scattered[path] = 0
    volumes.state.side[path] = 0
    volumes.state.lit[path] = 0


@wp.func
def behind_surface(
    geometry: Geometry,
    volumes: VolumeData,
    inside: wp.vec4i,
    instance: int,
    surface: SurfacePoint,
    direction: wp.vec3,
    is_closed: bool,
) -> wp.vec4i:
    """`inside` on the other side of a surface, in whose place there may be faces of other volumes. `direction`: of a
    ray that goes there.

    A volume is left if more of its faces there are met from the back, and entered if more are met from the front:
    parts of one mesh that stand side by side are one volume.
    """
    normal = surface.geometric_normal
    side = int(wp.static(FRONT))
    if wp.dot(normal, direction) > 0.0:
        side = int(wp.static(BACK))
    result = inside
    own = int(0)
    if is_closed:
        result = across(volumes, inside, instance, surface.material, side)
        volume = volumes.volume_of[surface.material]
        if volume >= 0:
            own = 1 + instance * volumes.volume_count + volume
    if volumes.enclosures.touching == 0:
        return result
    if side == wp.static(FRONT):
        normal = -normal
    position = surface.position
    # as `spawn_origin` begins the next ray
    reach = wp.length(spawn_origin(position, surface.error, normal, normal) - position)
    around = surface.error + wp.vec3(reach, reach, reach)
    low = position - around
    high = position + around
    near = wp.zeros(wp.static(NEAR_MOST), dtype=int)
    count = enclosures_near(volumes.enclosures, low, high, -1, near)
    while count > 0:
        for n in range(count):
            code = volumes.enclosures.of[near[n]].code
            passed = passed_at_once(geometry, volumes.enclosures, near[n], position, normal, reach, surface.time)
            if passed[0] > 0:
                if code == own and passed[1] == 0:
                    result = wp.where(holds(inside, code), entered(result, code), left(result, code))
                if passed[1] > 0:
                    result = entered(result, code)
                if passed[1] < 0:
                    result = left(result, code)
        count = enclosures_near(volumes.enclosures, low, high, near[count - 1], near)
    return result


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
        if side == 0 or (status & wp.static(_RAY_NEW | _SHADOW_NEW)) == 0:
            return
        instance = rays.hit_instance[path]
        material = material_at(data.geometry, instance, rays.hit_primitive[path])
        # the same volumes are on both sides, but where their faces may be in the same place
        if volumes.volume_of[material] < 0 and volumes.enclosures.touching == 0:
            if (status & wp.static(_SHADOW_NEW)) != 0:
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
        closed = is_closed(data.geometry, instance, rays.hit_primitive[path])
        behind = behind_surface(data.geometry, volumes, inside, instance, surface, -normal, closed)
        if (status & wp.static(_SHADOW_NEW)) != 0:
            goes_behind = wp.dot(rays.direction[paths.status.shape[0] + path], normal) < 0.0
            volumes.state.shadow_inside[path] = wp.where(goes_behind, behind, inside)
            volumes.state.shadow_segment[path] = 0
        # a step of a walk below the surface is in that medium alone, and comes out here again
        if (status & wp.static(_RAY_NEW)) != 0 and (status & wp.static(_INSIDE)) == 0:
            if wp.dot(rays.direction[path], normal) < 0.0:
                volumes.state.inside[path] = behind
                if volumes.is_boundary[material] != 0:
                    paths.passed[path] = paths.passed[path] - 1  # nobody sees such a surface

    return cross
