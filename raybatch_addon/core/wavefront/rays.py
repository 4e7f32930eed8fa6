"""All state of rays and paths on the device.

A path has two ray slots: slot `p` holds the ray that extends path `p` (closest hit), slot `path_count + p` its
shadow ray (occlusion). Both may be under way at once; the path goes on when both are back.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag

import warp as wp

from ..scene.features import SceneFeatures


class RayKind(IntEnum):
    """What is asked of a ray."""

    CLOSEST = 0  # the closest hit
    OCCLUSION = 1  # whether anything is hit
    TRANSPARENT_SHADOW = 2  # the closest hit, asked again from there on while surfaces let light through


class Status(IntFlag):
    """Bits of `Paths.status`; 0 is a free slot."""

    ALIVE = 1
    RAY_NEW = 2  # the extending ray waits to be submitted
    RAY_OUT = 4  # the extending ray is in the tracer
    SHADOW_NEW = 8  # the shadow ray waits to be submitted
    SHADOW_OUT = 16  # the shadow ray is in the tracer
    ENDED = 32  # the path ends when its shadow ray is back
    HIT = 64  # the extending ray came back with a hit


@wp.struct
class Rays:
    """Rays and their hits, one entry a ray slot."""

    origin: wp.array(dtype=wp.vec3)  # [m]
    direction: wp.array(dtype=wp.vec3)  # unit length in world space
    t_max: wp.array(dtype=float)  # only hits nearer than this count [m]
    visibility: wp.array(dtype=int)  # `Visibility` bit of the ray: objects without it are passed
    hit_t: wp.array(dtype=float)  # distance of the hit [m]
    hit_instance: wp.array(dtype=int)  # -1: nothing was hit. Of occlusion rays only this is set, and only its sign counts
    hit_primitive: wp.array(dtype=int)  # triangle of the instance's mesh
    hit_uv: wp.array(dtype=wp.vec2)  # barycentric weights of the triangle's second and third corner


@wp.struct
class Paths:
    """Shading state, one entry a path slot. Arrays that a scene does not need have no entries."""

    status: wp.array(dtype=int)  # `Status` bits
    pixel: wp.array(dtype=int)  # within the tile, row by row from its bottom left
    sample: wp.array(dtype=wp.uint32)  # sample index of the pixel
    bounce: wp.array(dtype=int)  # scattering events so far, straight passes not counted
    throughput: wp.array(dtype=wp.vec3)
    radiance: wp.array(dtype=wp.vec3)  # summed in bounce order
    pdf: wp.array(dtype=float)  # solid-angle density of the extending ray; 0: specular or from the camera
    shadow_light: wp.array(dtype=wp.vec3)  # what the shadow ray adds to `radiance` if nothing is in its way
    # transparency
    passed: wp.array(dtype=int)  # transparent surfaces passed by the extending ray, and (x 65536) by the shadow ray
    passed_t: wp.array(dtype=float)  # distance from the last scattering to the extending ray's origin [m]
    alpha: wp.array(dtype=float)  # coverage; transparent films
    # passes, filled at the first hit
    normal: wp.array(dtype=wp.vec3)


def allocate_rays(slot_count: int, device: wp.Device) -> Rays:
    """`Rays` for `slot_count` ray slots."""
    rays = Rays()
    with wp.ScopedDevice(device):
        rays.origin = wp.zeros(slot_count, dtype=wp.vec3)
        rays.direction = wp.zeros(slot_count, dtype=wp.vec3)
        rays.t_max = wp.zeros(slot_count, dtype=float)
        rays.visibility = wp.zeros(slot_count, dtype=int)
        rays.hit_t = wp.zeros(slot_count, dtype=float)
        rays.hit_instance = wp.full(slot_count, -1, dtype=int)
        rays.hit_primitive = wp.zeros(slot_count, dtype=int)
        rays.hit_uv = wp.zeros(slot_count, dtype=wp.vec2)
    return rays


def allocate_paths(path_count: int, features: SceneFeatures, device: wp.Device) -> Paths:
    """`Paths` for `path_count` slots, all free."""

    def zeros(dtype, needed: bool = True):
        return wp.zeros(path_count if needed else 0, dtype=dtype, device=device)

    paths = Paths()
    paths.status = zeros(int)
    paths.pixel = zeros(int)
    paths.sample = zeros(wp.uint32)
    paths.bounce = zeros(int)
    paths.throughput = zeros(wp.vec3)
    paths.radiance = zeros(wp.vec3)
    paths.pdf = zeros(float)
    paths.shadow_light = zeros(wp.vec3, features.shadow_rays)
    paths.passed = zeros(int, features.transparency)
    paths.passed_t = zeros(float, features.transparency)
    paths.alpha = zeros(float, features.film_transparent)
    paths.normal = zeros(wp.vec3, "Normal" in features.passes)
    return paths


def bytes_per_path(features: SceneFeatures) -> int:
    """Device memory of one path alive: state, its ray slots, and its places in lists [bytes]."""
    ray = 12 + 12 + 4 + 4 + 4 + 4 + 4 + 8
    path = 4 * 4 + 12 + 12 + 4
    path += 12 * features.shadow_rays + 8 * features.transparency
    path += 4 * features.film_transparent + 12 * ("Normal" in features.passes)
    lists = 2 * 8 + 6 * 4  # two work arrays of the scan and six lists
    spill = 8 * (4 + 3 * ("Normal" in features.passes))
    return path + ray * (1 + features.shadow_rays) + lists + spill
