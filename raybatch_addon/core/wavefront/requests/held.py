"""A path's own ray, set aside while rays are traced for it, and these rays in its place."""

from __future__ import annotations

import warp as wp

from ...rays import Rays
from ..rays import Paths, Status, visibility_of
from .state import Requests

_RAY_NEW, _HIT = int(Status.RAY_NEW), int(Status.HIT)
# Dimension sets of requests: between those of walks and of volumes, one for each of so many of a surface
FIRST_DIMENSION = 2 << 30
REQUESTS_MOST = 256


@wp.func
def send(requests: Requests, paths: Paths, rays: Rays, path: int, origin: wp.vec3, direction: wp.vec3, length: float):
    """Let the path trace a ray that is no step of it."""
    requests.left[path] = length
    rays.origin[path] = origin
    rays.direction[path] = direction
    rays.t_max[path] = length
    paths.status[path] = (paths.status[path] & wp.static(~_HIT)) | wp.static(_RAY_NEW)


@wp.func
def hold(requests: Requests, rays: Rays, path: int):
    """Set the path's ray and hit aside."""
    requests.origin[path] = rays.origin[path]
    requests.direction[path] = rays.direction[path]
    requests.t_max[path] = rays.t_max[path]
    requests.hit_t[path] = rays.hit_t[path]
    requests.hit_instance[path] = rays.hit_instance[path]
    requests.hit_primitive[path] = rays.hit_primitive[path]
    requests.hit_uv[path] = rays.hit_uv[path]


@wp.func
def give_back(requests: Requests, paths: Paths, rays: Rays, path: int):
    """Give the path its ray and hit again."""
    rays.origin[path] = requests.origin[path]
    rays.direction[path] = requests.direction[path]
    rays.t_max[path] = requests.t_max[path]
    rays.hit_t[path] = requests.hit_t[path]  # last: it may share memory with `t_max`
    rays.hit_instance[path] = requests.hit_instance[path]
    rays.hit_primitive[path] = requests.hit_primitive[path]
    rays.hit_uv[path] = requests.hit_uv[path]
    if rays.visibility.shape[0] > 0:
        rays.visibility[path] = visibility_of(paths.status[path])
    paths.status[path] = paths.status[path] | wp.static(_HIT)
