"""The stages of a path as functions of one path, which the kernel of the streaming schedule calls: those of the
wavefront's kernels.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import warp as wp

from ...device.codegen.single import function_of
from ...film import layout_of
from ...film.tile import FilmTile
from ...rays import Rays
from ...scene.features import SceneFeatures, narrow
from ...shading.camera import CameraData
from ..kernels import stage_functions
from ..rays import Paths, Status
from ..scene.shading_data import SceneData
from ..stages.accumulate import accumulate_kernel
from ..stages.connect import settle_kernel
from ..stages.generate import GenerateFeatures, active_number, make_begin_path
from ..stages.limits import PathLimits
from ..stages.surface.aim import AimFeatures
from ..stages.walk import WalkFeatures, walk_kernel
from ..stages.work import ShadingStage, TileWork
from ..volumes.cross import cross_kernel, enter_kernel
from ..volumes.features import VolumeFeatures
from ..volumes.scatter import make_scatter
from ..volumes.table import VolumeData
from ..volumes.transmit import make_transmit
from .queues import Queue

_ALIVE, _ENDED, _HIT = int(Status.ALIVE), int(Status.ENDED), int(Status.HIT)
_RAY_NEW, _RAY_OUT = int(Status.RAY_NEW), int(Status.RAY_OUT)
_SHADOW_NEW, _SHADOW_OUT = int(Status.SHADOW_NEW), int(Status.SHADOW_OUT)
_NOT_BACK = _ENDED | _RAY_NEW | _RAY_OUT | _SHADOW_NEW | _SHADOW_OUT

settle = function_of(settle_kernel)
"""Function (paths, rays, slots, one): the extending ray of a path is back."""


@wp.struct
class Whereto:
    """Where a token goes."""

    token: int
    queue: int


@wp.func
def whereto(paths: Paths, path: int) -> Whereto:
    """Where a path goes behind a stage that shades. Of two new rays that for shadows goes first, so that a path has one
    token; what it brings is added before the path goes on in either schedule.
    """
    status = paths.status[path]
    result = Whereto()
    result.token = path
    if (status & wp.static(_SHADOW_NEW)) != 0:
        paths.status[path] = status ^ wp.static(_SHADOW_NEW | _SHADOW_OUT)
        result.token = paths.status.shape[0] + path
        result.queue = wp.static(int(Queue.SHADOW))
    elif (status & wp.static(_RAY_NEW)) != 0:
        paths.status[path] = status ^ wp.static(_RAY_NEW | _RAY_OUT)
        result.queue = wp.static(int(Queue.TRACE))
    elif (status & wp.static(_ENDED)) != 0:
        result.queue = wp.static(int(Queue.FILM))
    elif (status & wp.static(_HIT)) != 0:
        result.queue = wp.static(int(Queue.SURFACE))
    else:
        result.queue = wp.static(int(Queue.BACKGROUND))
    return result


@wp.func
def is_back(paths: Paths, path: int) -> bool:
    """Whether a path waits for nothing and has not ended."""
    return (paths.status[path] & wp.static(_ALIVE | _NOT_BACK)) == wp.static(_ALIVE)


@dataclass(frozen=True, kw_only=True)
class StreamStages:
    """Functions of one path. `slots` is a list of it alone, `one` the length of that list."""

    begin: wp.Function  # (data, volumes, work, limits, camera, paths, rays, slots, one, active, item)
    connect: wp.Function  # (data, volumes, work, limits, paths, rays, film, slots, one), of shadow rays
    background: wp.Function  # the same, of a path
    surface: wp.Function | None  # None: `background` is for both
    accumulate: wp.Function  # (work, paths, film, slots, one)


@functools.cache
def stream_stages(features: SceneFeatures) -> StreamStages:
    """The stages for a scene with `features`."""
    apart = not asks_for_rays(features)
    return StreamStages(
        begin=_make_begin(features),
        connect=_make_connect(features),
        background=_make_shade(features, (Queue.BACKGROUND,) if apart else (Queue.BACKGROUND, Queue.SURFACE)),
        surface=_make_shade(features, (Queue.SURFACE,)) if apart else None,
        accumulate=function_of(accumulate_kernel(layout_of(features.passes, features.film_transparent))),
    )


def _functions(features: SceneFeatures):
    return stage_functions(features, narrow(features, AimFeatures) if features.shadow_rays else None)


def _make_begin(features: SceneFeatures) -> wp.Function:
    begin_path = make_begin_path(narrow(features, GenerateFeatures))
    enter = function_of(enter_kernel) if features.volumes else None

    @wp.func
    def begin(
        data: SceneData,
        volumes: VolumeData,
        work: TileWork,
        limits: PathLimits,
        camera: CameraData,
        paths: Paths,
        rays: Rays,
        slots: wp.array(dtype=int),
        one: wp.array(dtype=int),
        active: wp.array(dtype=int),
        item: int,
    ):
        number = wp.uint32(work.item_first - work.item_base) + wp.uint32(item)
        if wp.static(features.adaptive):
            if active.shape[0] > 0:
                number = active_number(work, active, work.item_first + wp.int64(item))
        begin_path(work, limits, camera, paths, rays, slots[0], number)
        if wp.static(features.volumes):
            enter(data.geometry, volumes, rays, slots, one)

    return begin


def _make_connect(features: SceneFeatures) -> wp.Function:
    stage = ShadingStage.CONNECT_TRANSPARENT if features.transparency else ShadingStage.CONNECT
    function = _functions(features)[stage]() if features.shadow_rays else None
    transmit = make_transmit(narrow(features, VolumeFeatures)) if features.volumes else None

    @wp.func
    def connect(
        data: SceneData,
        volumes: VolumeData,
        work: TileWork,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        film: FilmTile,
        slots: wp.array(dtype=int),
        one: wp.array(dtype=int),
    ):
        if wp.static(transmit is not None):
            transmit(data, volumes, work, limits, paths, rays, slots[0])
        if wp.static(function is not None):
            function(data, work, limits, paths, rays, film, slots[0])

    return connect


def asks_for_rays(features: SceneFeatures) -> bool:
    """Whether a program, or a pass, asks for rays, which come back to a path before it is shaded."""
    return bool(features.requests or features.occlusion_pass)


def _make_shade(features: SceneFeatures, queues: tuple[Queue, ...]) -> wp.Function:
    """What happens to a path that is back, from one of `queues`, in the order of the wavefront's stages."""
    made = _functions(features)
    request = made[ShadingStage.REQUEST]() if features.requests else None
    occlusion = made[ShadingStage.OCCLUSION]() if features.occlusion_pass else None
    walk = function_of(walk_kernel(narrow(features, WalkFeatures))) if features.subsurface else None
    scatter = make_scatter(narrow(features, VolumeFeatures)) if features.volumes else None
    light_hits = made[ShadingStage.LIGHT_HITS]() if features.light_hits and not features.volumes else None
    background = made[ShadingStage.BACKGROUND]() if Queue.BACKGROUND in queues else None
    surface = cross = None
    if Queue.SURFACE in queues and features.surfaces:
        surface = made[ShadingStage.SURFACE]()
        cross = function_of(_cross_kernel(features)) if features.volumes else None

    @wp.func
    def shade(
        data: SceneData,
        volumes: VolumeData,
        work: TileWork,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        film: FilmTile,
        slots: wp.array(dtype=int),
        one: wp.array(dtype=int),
    ):
        path = slots[0]
        if wp.static(request is not None):
            request(data, work, limits, paths, rays, film, path)
        if wp.static(occlusion is not None):
            if is_back(paths, path):
                occlusion(data, work, limits, paths, rays, film, path)
        if wp.static(walk is not None):
            if is_back(paths, path):
                walk(data, work, limits, paths, rays, slots, one)
        if wp.static(scatter is not None):
            if is_back(paths, path):
                scatter(data, volumes, work, limits, paths, rays, path)
        if not is_back(paths, path):
            return
        hit = (paths.status[path] & wp.static(_HIT)) != 0
        if wp.static(light_hits is not None):
            light_hits(data, work, limits, paths, rays, film, path)
        if wp.static(background is not None):
            if not hit:
                background(data, work, limits, paths, rays, film, path)
        if wp.static(surface is not None):
            if hit:
                surface(data, work, limits, paths, rays, film, path)
                if wp.static(cross is not None):
                    cross(data, volumes, paths, rays, slots, one)

    return shade


def _cross_kernel(features: SceneFeatures) -> wp.Kernel:
    needs = narrow(features, VolumeFeatures)
    return cross_kernel(needs.instancing, needs.smooth_normals, needs.curves, needs.moving)
