"""Paths that meet a shadow catcher before they scatter: their light from there on counts apart, and then they go on
once more from the ray before it, where rays see catchers alone. Both meet the same random numbers, as in Cycles.

A slot holds these lives of a path one after another. Stages know little of it: between turns they are given rays with
other visibility, and rows of passes that belong to another life are put back.
"""

from __future__ import annotations

import warp as wp

from ...device.kernel import KERNEL_OPTIONS
from ...rays import Rays
from ...scene.description import ALL_SHADOW_SETS, CATCHER_SHIFT, SCATTERED_RAYS, SHADOW_SET_SHIFT, Visibility
from ..rays import VISIBILITY_SHIFT, Paths, Status, bounce_of
from ..volumes.table import MediaState
from .state import CaughtPaths, Life

_ALIVE, _ENDED = int(Status.ALIVE), int(Status.ENDED)
_RAY_NEW, _SHADOW_NEW = int(Status.RAY_NEW), int(Status.SHADOW_NEW)
_INSIDE, _HIT = int(Status.INSIDE), int(Status.HIT)
_WAITING = int(Status.RAY_NEW | Status.RAY_OUT | Status.SHADOW_NEW | Status.SHADOW_OUT)
_CAMERA, _SHADOW, _ALL = int(Visibility.CAMERA), int(Visibility.SHADOW), int(Visibility.ALL)
_BY_VOLUME = int(Visibility.VOLUME_SCATTER)
# What volumes of catchers scatter sees catchers that any other ray sees
_SEEN_BY_VOLUMES = int(Visibility.CAMERA) | SCATTERED_RAYS
_MAIN, _WORLD, _COPY, _NEW_COPY = (int(life) for life in (Life.MAIN, Life.WORLD, Life.COPY, Life.NEW_COPY))
RESTARTED = int(Status.ALIVE | Status.RAY_NEW) | _CAMERA << VISIBILITY_SHIFT


@wp.kernel(**KERNEL_OPTIONS)
def catch_kernel(paths: Paths, rays: Rays, caught: CaughtPaths, slots: wp.array(dtype=int), count: wp.array(dtype=int)):
    """Paths whose rays are back, before surfaces and the world shade them: those that have met a catcher first are to
    live again; in another life the way to the catcher gave its light and took its share already.
    """
    i = wp.tid()
    if i >= count[0]:
        return
    path = slots[i]
    status = paths.status[path]
    life = paths.passes[0].life[path]
    if life == wp.static(_WORLD) or life == wp.static(_NEW_COPY):
        paths.radiance[path] = wp.vec3(0.0, 0.0, 0.0)
        paths.throughput[path] = caught.throughput[path]
        if life == wp.static(_NEW_COPY):
            paths.passes[0].life[path] = wp.static(_COPY)
        return
    if bounce_of(status) != 0 or (status & wp.static(_INSIDE | _HIT)) != wp.static(_HIT) or life != 0:
        return
    if caught.is_catcher[rays.hit_instance[path]] == 0:
        return
    throughput = paths.throughput[path]
    paths.passes[0].life[path] = wp.static(_MAIN)
    caught.origin[path] = rays.origin[path]
    caught.direction[path] = rays.direction[path]
    caught.t_max[path] = rays.t_max[path]
    caught.throughput[path] = throughput
    if caught.passed.shape[0] > 0:
        caught.passed[path] = paths.passed[path]
        caught.passed_t[path] = paths.passed_t[path]
    alpha = float(1.0)
    if paths.alpha.shape[0] > 0:
        alpha = paths.alpha[path]
    caught.alpha[path] = alpha - (throughput[0] + throughput[1] + throughput[2]) / 3.0
    caught.radiance[path] = paths.radiance[path]
    paths.radiance[path] = wp.vec3(0.0, 0.0, 0.0)
    for c in range(caught.values.shape[0]):
        caught.values[c, path] = paths.passes[0].values[c, path]


@wp.func
def _set_channels(values: wp.array2d(dtype=float), first: int, path: int, value: wp.vec3):
    if first >= 0:
        for c in range(3):
            values[first + c, path] = value[c]


@wp.func
def _end_main(paths: Paths, caught: CaughtPaths, path: int):
    """Keep what the path brought behind the catcher."""
    light = paths.radiance[path]
    caught.radiance[path] = caught.radiance[path] + light
    for c in range(caught.values.shape[0]):
        if caught.of_light[c] == 0:
            caught.values[c, path] = paths.passes[0].values[c, path]
    _set_channels(caught.values, caught.caught, path, light)
    alpha = float(1.0)
    if paths.alpha.shape[0] > 0:
        alpha = paths.alpha[path]
    caught.values[caught.coverage, path] = alpha - caught.alpha[path]
    caught.alpha[path] = alpha


@wp.func
def _end_world(paths: Paths, caught: CaughtPaths, path: int):
    """Keep the world behind the catcher."""
    _set_channels(caught.values, caught.behind, path, paths.radiance[path])
    if caught.environment >= 0:
        for c in range(3):
            row = caught.environment + c
            caught.values[row, path] = paths.passes[0].values[row, path]


@wp.func
def _put_back(paths: Paths, caught: CaughtPaths, path: int):
    """What the path has besides its light, as it was before this life."""
    for c in range(caught.values.shape[0]):
        paths.passes[0].values[c, path] = caught.values[c, path]
    if paths.alpha.shape[0] > 0:
        paths.alpha[path] = caught.alpha[path]


@wp.func
def _begin_again(paths: Paths, rays: Rays, media: MediaState, caught: CaughtPaths, path: int, life: int):
    """Let the path begin `life`, with the ray before the catcher."""
    paths.passes[0].life[path] = life
    paths.radiance[path] = wp.vec3(0.0, 0.0, 0.0)
    paths.throughput[path] = caught.throughput[path]
    paths.pdf[path] = 0.0
    if caught.passed.shape[0] > 0:
        paths.passed[path] = caught.passed[path]
        paths.passed_t[path] = caught.passed_t[path]
    if paths.history.shape[0] > 0:
        paths.history[path] = 0
    if media.inside.shape[0] > 0:  # what fills other objects is not there either
        media.inside[path] = wp.vec4i(0, 0, 0, 0)
        media.segment[path] = 0
        media.scattered[path] = 0
        media.side[path] = 0
        media.lit[path] = 0
    rays.origin[path] = caught.origin[path]
    rays.direction[path] = caught.direction[path]
    rays.t_max[path] = caught.t_max[path]
    rays.visibility[path] = wp.where(life >= wp.static(_COPY), wp.static(_CAMERA << CATCHER_SHIFT), 0)
    paths.status[path] = wp.static(RESTARTED)


@wp.func
def _to_catchers(visibility: int) -> int:
    """A visibility for which there are catchers alone; the same if it is that already."""
    kinds = visibility & wp.static(_ALL)
    if (visibility & wp.static(ALL_SHADOW_SETS << SHADOW_SET_SHIFT)) != 0:
        kinds = wp.static(_SHADOW)
    if kinds == 0:
        return visibility
    if kinds == wp.static(_BY_VOLUME):
        kinds = wp.static(_SEEN_BY_VOLUMES)
    return kinds << wp.static(CATCHER_SHIFT)


@wp.kernel(**KERNEL_OPTIONS)
def lives_kernel(paths: Paths, rays: Rays, media: MediaState, caught: CaughtPaths):
    """Between turns: paths that are at the end of a life begin the next, and rays of copies see catchers alone."""
    path = wp.tid()
    status = paths.status[path]
    if (status & wp.static(_ALIVE)) == 0:
        return
    life = paths.passes[0].life[path]
    if life == 0:
        return
    if (status & wp.static(_ENDED | _WAITING)) == wp.static(_ENDED):
        if life >= wp.static(_COPY):
            _set_channels(caught.values, caught.copied, path, paths.radiance[path])
            _put_back(paths, caught, path)
            paths.radiance[path] = caught.radiance[path]
            paths.passes[0].life[path] = 0
            return
        following = int(wp.static(_NEW_COPY))
        if life == wp.static(_MAIN):
            _end_main(paths, caught, path)
            if caught.shows_world != 0:
                following = wp.static(_WORLD)
        else:
            _end_world(paths, caught, path)
        _put_back(paths, caught, path)
        _begin_again(paths, rays, media, caught, path, following)
        return
    if life >= wp.static(_COPY):
        if (status & wp.static(_RAY_NEW)) != 0:
            rays.visibility[path] = _to_catchers(rays.visibility[path])
        if (status & wp.static(_SHADOW_NEW)) != 0:
            slot = paths.status.shape[0] + path
            rays.visibility[slot] = _to_catchers(rays.visibility[slot])


CATCHER_KERNELS = (catch_kernel, lives_kernel)
