"""Stages that shade, as kernels: one for each stage, or one that holds all of them.

CUDA's compiler copies whatever is out of line to each kernel that calls it, and takes a minute for each copy of the
interpreter of all ops. So the stages of the general tier are one kernel, which is launched for one stage at a time.
"""

from __future__ import annotations

import functools

import warp as wp

from ...device.kernel import DEFAULT_BLOCK_SIZE, general_options, kernel_options, with_block_size
from ...film.tile import FilmTile
from ...native.build import native_source
from ...rays import Rays
from ...scene.geometry import Geometry
from ..rays import Paths
from ..scene.shading_data import SceneData
from .limits import PathLimits
from .work import ShadingStage, TileWork

# Threads of a CUDA block, and registers of a thread at most, of stages that gain by it: how many threads wait for
# memory and instructions at once, against what is spilled. The best of eight pairs on an H200, the demo, a living room,
# a doughnut and the BMW together: 0.89 of the time at surfaces, 0.85 where light is aimed at.
_LAUNCHES = {
    ShadingStage.SURFACE: (DEFAULT_BLOCK_SIZE, 128),
    ShadingStage.CONNECT_TRANSPARENT: (DEFAULT_BLOCK_SIZE, 128),
    ShadingStage.AIM: (128, 80),
    ShadingStage.LIGHT_HITS: (128, 80),
}


# A launch on a CPU runs in one thread, in a loop around the kernel that copies all of its arguments each time: some
# thousand bytes for a stage, which took 5 % of its time. So the first of its threads goes through all slots itself.
@wp.func_native(native_source("threads/first.h"))
def first_of_thread(thread: int) -> int:
    """The first index of a thread; on a CPU the threads behind the first one have none."""


@wp.func_native(native_source("threads/next.h"))
def next_of_thread(i: int) -> int:
    """The index of a thread that follows `i`; beyond all counts on a GPU, where a thread has one."""


# How many paths ahead: as many as take about the time of a read from memory
@wp.func_native(native_source("prefetch/hits.h", LATER=8, SOONER=4))
def prefetch_hits(geometry: Geometry, rays: Rays, slots: wp.array(dtype=int), i: int, count: int):
    """Bring what the vertices of paths behind index `i` of `slots` read of their triangles nearer to a CPU."""


def stage_thread_count(slot_count: int, device: wp.Device) -> int:
    """Threads to launch of a stage's kernel for up to `slot_count` slots."""
    return slot_count if device.is_cuda else min(slot_count, 1)


@functools.cache
def stage_kernel(function: wp.Function, of: ShadingStage, out_of_line: bool = False) -> wp.Kernel:
    """Kernel (data, work, limits, paths, rays, film, slots, count) of the stage `of` that calls `function` for each of
    the first `count` slots, with a slot in place of the last two.

    `out_of_line`: compile it for a CPU in less time (`OUT_OF_LINE_OPTIONS`).
    """

    def stage(
        data: SceneData,
        work: TileWork,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        film: FilmTile,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
    ):
        i = first_of_thread(wp.tid())
        while i < count[0]:
            if wp.static(of == ShadingStage.SURFACE):
                prefetch_hits(data.geometry, rays, slots, i, count[0])
            function(data, work, limits, paths, rays, film, slots[i])
            i = next_of_thread(i)

    stage.__name__ = stage.__qualname__ = f"{function.func.__name__}_kernel"
    block_size, registers = _LAUNCHES.get(of, (DEFAULT_BLOCK_SIZE, None))
    limit = {} if registers is None else {"cuda_max_registers": registers}
    kernel = wp.kernel(stage, **kernel_options(out_of_line), **limit)
    return with_block_size(kernel, block_size)


# Stages of the kernel of all of them, in the order of its functions; both that connect are one
STAGES_OF_ALL = (
    ShadingStage.SURFACE,
    ShadingStage.BACKGROUND,
    ShadingStage.LIGHT_HITS,
    ShadingStage.CONNECT_TRANSPARENT,
    ShadingStage.REQUEST,
    ShadingStage.OCCLUSION,
)


@functools.cache
def all_stages_kernel(
    surface: wp.Function,
    background: wp.Function,
    light_hits: wp.Function,
    connect_transparent: wp.Function,
    request: wp.Function | None,
    occlusion: wp.Function | None,
    of: tuple[str, ...],
) -> wp.Kernel:
    """Kernel of the arguments of `stage_kernel` that calls the function of the stage `work.stage`, for the functions of
    `STAGES_OF_ALL`; None where it is never launched for a stage. `of` is that of `general_options`.
    """

    @wp.kernel(**general_options("stages", of))
    def all_stages(
        data: SceneData,
        work: TileWork,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        film: FilmTile,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
    ):
        i = first_of_thread(wp.tid())
        while i < count[0]:
            slot = slots[i]
            if work.stage == wp.static(int(ShadingStage.SURFACE)):
                prefetch_hits(data.geometry, rays, slots, i, count[0])
                surface(data, work, limits, paths, rays, film, slot)
            elif work.stage == wp.static(int(ShadingStage.BACKGROUND)):
                background(data, work, limits, paths, rays, film, slot)
            elif work.stage == wp.static(int(ShadingStage.LIGHT_HITS)):
                light_hits(data, work, limits, paths, rays, film, slot)
            elif work.stage <= wp.static(int(ShadingStage.CONNECT_TRANSPARENT)):
                connect_transparent(data, work, limits, paths, rays, film, slot)
            if wp.static(request is not None):
                if work.stage == wp.static(int(ShadingStage.REQUEST)):
                    request(data, work, limits, paths, rays, film, slot)
            if wp.static(occlusion is not None):
                if work.stage == wp.static(int(ShadingStage.OCCLUSION)):
                    occlusion(data, work, limits, paths, rays, film, slot)
            i = next_of_thread(i)

    return all_stages
