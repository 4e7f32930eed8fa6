"""Light that arrives at a path, also divided among passes: by how often it was scattered, and by what at first."""

from __future__ import annotations

import functools

import warp as wp

from ...shading.bsdf.bsdf import DELTA, TRANSMISSION
from ..rays import Paths
from .state import add_channels

# The last of `PathPasses.share` where a volume scattered first
_BY_VOLUME = 2.0


@wp.func
def diffuse_share(value: wp.vec3, diffuse: wp.vec3, reflected: bool) -> wp.vec4:
    """How light in a direction is divided: the part `diffuse` of a BSDF's `value` as `PathPasses.share` has it."""
    share = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for c in range(3):
        if value[c] != 0.0:
            share[c] = diffuse[c] / value[c]
    if reflected:
        share[3] = 1.0
    return share


@wp.func
def divide_shadow_ray(paths: Paths, path: int, bounce: int, value: wp.vec3, diffuse: wp.vec3, reflected: bool):
    """Note how the light that a shadow ray brings to a vertex is divided. `bounce`: scattering events before it."""
    passes = paths.passes[0]
    if passes.shadow_share.shape[0] > 0:
        share = passes.share[path]
        if bounce == 0:
            share = diffuse_share(value, diffuse, reflected)
        passes.shadow_share[path] = share


@wp.func
def divide_extending_ray(paths: Paths, path: int, value: wp.vec3, diffuse: wp.vec3, lobe: int, reflected: bool):
    """Note how the light is divided that comes along the direction in which `lobe` (bits of `shading/bsdf/bsdf.py`)
    scattered the path, where it scatters first.
    """
    passes = paths.passes[0]
    if passes.share.shape[0] > 0:
        share = wp.vec4(0.0, 0.0, 0.0, wp.where((lobe & TRANSMISSION) != 0, 0.0, 1.0))
        if (lobe & DELTA) == 0:
            share = diffuse_share(value, diffuse, reflected)
        passes.share[path] = share


@wp.func
def divide_volume_shadow_ray(paths: Paths, path: int, bounce: int):
    """Note how the light of a shadow ray to a vertex in a volume is divided. `bounce`: scattering events before it."""
    passes = paths.passes[0]
    if passes.shadow_share.shape[0] > 0:
        share = passes.share[path]
        if bounce == 0:
            share = wp.vec4(0.0, 0.0, 0.0, wp.static(_BY_VOLUME))
        passes.shadow_share[path] = share


@wp.func
def divide_volume_ray(paths: Paths, path: int):
    """Note that a volume scattered a path first."""
    passes = paths.passes[0]
    if passes.share.shape[0] > 0:
        passes.share[path] = wp.vec4(0.0, 0.0, 0.0, wp.static(_BY_VOLUME))


@wp.func
def split_light(paths: Paths, path: int, light: wp.vec3, bounce: int, by_shadow_ray: bool, seen: int):
    """Add `light` to the passes of `path` that it belongs to. `bounce`: how often it was scattered on its way;
    `seen`: the first channel of light that was not.
    """
    passes = paths.passes[0]
    if bounce == 0:
        add_channels(passes, seen, path, light)
    elif passes.share.shape[0] > 0:
        share = passes.share[path]
        if by_shadow_ray and passes.shadow_share.shape[0] > 0:
            share = passes.shadow_share[path]
        channels = passes.direct
        if bounce > 1:
            channels = passes.indirect
        diffuse = wp.cw_mul(light, wp.vec3(share[0], share[1], share[2]))
        add_channels(passes, channels[0], path, diffuse)
        other = channels[2]
        if share[3] == 1.0:
            other = channels[1]
        elif share[3] == wp.static(_BY_VOLUME):
            other = passes.volume[wp.where(bounce > 1, 1, 0)]
        add_channels(passes, other, path, light - diffuse)


@wp.func
def shows_environment(paths: Paths) -> bool:
    """Whether there is a pass of the world's light that is seen without scattering."""
    if paths.passes.shape[0] > 0:
        return paths.passes[0].environment >= 0
    return False


@wp.func
def has_groups(paths: Paths) -> bool:
    """Whether shadow rays bring light to the passes of light groups."""
    if paths.passes.shape[0] > 0:
        return paths.passes[0].shadow_group.shape[0] > 0
    return False


@wp.func
def add_to_group(paths: Paths, path: int, light: wp.vec3, group: int):
    """Add `light` to the pass of the light group of this number; -1: to none."""
    if group >= 0 and paths.passes.shape[0] > 0:
        add_channels(paths.passes[0], paths.passes[0].group + 3 * group, path, light)


@functools.cache
def make_add_light(splits: bool, groups: bool = False) -> wp.Function:
    """Function (paths, path, light: vec3, bounce: int, by_shadow_ray: bool) that adds light of surfaces and lights to a
    path, and where it `splits` to the passes as well. With `groups` what a shadow ray brings goes to the pass of its
    light group too; whoever adds other light adds it to its group (`add_to_group`).
    """

    @wp.func
    def add_light(paths: Paths, path: int, light: wp.vec3, bounce: int, by_shadow_ray: bool):
        paths.radiance[path] = paths.radiance[path] + light
        if wp.static(splits):
            if paths.passes.shape[0] > 0:
                split_light(paths, path, light, bounce, by_shadow_ray, paths.passes[0].emission)
        if wp.static(groups):
            if by_shadow_ray and has_groups(paths):
                add_to_group(paths, path, light, paths.passes[0].shadow_group[path])

    return add_light
