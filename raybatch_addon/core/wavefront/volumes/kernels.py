"""The stages of volumes that run programs, as kernels: one for each, or one that holds all of them, as with the stages
that shade surfaces.
"""

from __future__ import annotations

import dataclasses
import functools

import warp as wp

from ...device.devices import load_module
from ...device.kernel import KERNEL_OPTIONS, general_options, kernel_options
from ...rays import Rays
from ..rays import Paths
from ..scene.shading_data import SceneData
from ..stages.limits import PathLimits
from ..stages.work import TileWork, VolumeStage
from .bounds import make_bound
from .features import VolumeFeatures
from .scatter import make_scatter
from .table import VolumeData
from .transmit import make_transmit

# Registers of a CUDA thread at most: flights wait for programs, and the more of them wait at once the better. Time of
# both stages beside what the compiler chooses, on an H100, one run each: galaxy 0.91, nebula 0.88, space 0.79, clouds
# 1.05. General kernels and those that find bounds are left as the compiler likes
_REGISTERS = 64


def volume_kernel(features: VolumeFeatures, out_of_line: bool) -> wp.Kernel:
    """Kernel (data, volumes, work, limits, paths, rays, slots, count) of the stage `scatter`.

    `out_of_line`: compile what is specialised for a CPU in less time (`OUT_OF_LINE_OPTIONS`).
    """
    if features.volume_program.apart:
        return _general_kernel(features)
    return _stage_kernel(make_scatter(features), out_of_line)


def transmit_kernel(features: VolumeFeatures, out_of_line: bool) -> wp.Kernel:
    """Kernel of the same arguments, of the stage `transmit`."""
    if features.volume_program.apart:
        return _general_kernel(features)
    return _stage_kernel(make_transmit(features), out_of_line)


def bound_kernel(features: VolumeFeatures) -> wp.Kernel:
    """Kernel (volumes) that finds bounds, or the one that holds all stages."""
    if features.volume_program.apart:
        return _general_kernel(features)
    return _bound_kernel(make_bound(features.volume_program, features.volume_lights))


def launch_bound(features: VolumeFeatures, volumes: VolumeData, count: int, device: wp.Device) -> None:
    """Find bounds of the first `count` cells that `volumes` asks for."""
    kernel = bound_kernel(features)
    load_module(kernel, device)
    inputs = [volumes]
    if features.volume_program.apart:
        work, nothing = TileWork(), wp.zeros(1, dtype=int, device=device)
        work.stage = int(VolumeStage.BOUND)
        inputs = [SceneData(), volumes, work, PathLimits(), Paths(), Rays(), nothing, nothing]
    wp.launch(kernel, count, inputs, device=device)


@functools.cache
def _stage_kernel(function: wp.Function, out_of_line: bool) -> wp.Kernel:
    def stage(
        data: SceneData,
        volumes: VolumeData,
        work: TileWork,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
    ):
        i = wp.tid()
        if i >= count[0]:
            return
        function(data, volumes, work, limits, paths, rays, slots[i])

    stage.__name__ = stage.__qualname__ = f"{function.func.__name__}_kernel"
    return wp.kernel(stage, **kernel_options(out_of_line), cuda_max_registers=_REGISTERS)


@functools.cache
def _bound_kernel(function: wp.Function) -> wp.Kernel:
    @wp.kernel(**KERNEL_OPTIONS)
    def bound(volumes: VolumeData):
        function(volumes, wp.tid())

    return bound


def _general_kernel(features: VolumeFeatures) -> wp.Kernel:
    # lamps are in the same interpreter as volumes
    features = dataclasses.replace(features, lamp_program=dataclasses.replace(features.volume_program, flows=False))
    program = features.volume_program
    return _kernel_of_all(
        make_scatter(features), make_transmit(features), make_bound(program, features.volume_lights), program.ops
    )


@functools.cache
def _kernel_of_all(scatter: wp.Function, transmit: wp.Function, bound: wp.Function, of: tuple[str, ...]) -> wp.Kernel:
    @wp.kernel(**general_options("volumes", of))
    def all_of_volumes(
        data: SceneData,
        volumes: VolumeData,
        work: TileWork,
        limits: PathLimits,
        paths: Paths,
        rays: Rays,
        slots: wp.array(dtype=int),
        count: wp.array(dtype=int),
    ):
        i = wp.tid()
        if work.stage == wp.static(int(VolumeStage.BOUND)):
            bound(volumes, i)
            return
        if i >= count[0]:
            return
        if work.stage == wp.static(int(VolumeStage.SCATTER)):
            scatter(data, volumes, work, limits, paths, rays, slots[i])
        else:
            transmit(data, volumes, work, limits, paths, rays, slots[i])

    return all_of_volumes
