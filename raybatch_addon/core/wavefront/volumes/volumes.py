"""Volumes of one worker: the state of its paths in them, and the launches of their stages."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import warp as wp

from ...programs.ops.inputs.grids import GRID_OPS
from ...scene.features import SceneFeatures, narrow
from .cross import cross_kernel, enter_kernel
from .emission.estimate import inside_kernel
from .features import VolumeFeatures
from .grids import store_numbers, store_vectors
from .kernels import bound_kernel, transmit_kernel, volume_kernel
from .medium import may_vary
from .table import COUNT_ROWS, COUNTS, MediaState, VolumeData


@dataclass(frozen=True, kw_only=True)
class VolumeKernels:
    """Kernels of the stages of volumes."""

    enter: wp.Kernel
    scatter: wp.Kernel
    cross: wp.Kernel
    transmit: wp.Kernel
    bound: wp.Kernel | None  # None: no program gives coefficients that vary
    store_numbers: wp.Kernel | None  # None: no program reads grids
    store_vectors: wp.Kernel | None
    inside: wp.Kernel | None  # None: no volume is aimed at

    @staticmethod
    def choose(features: SceneFeatures, shading: SceneFeatures, out_of_line: bool) -> VolumeKernels | None:
        """The kernels of a scene with `features`, specialised on `shading`; None where there are no volumes.

        `out_of_line`: as for `volume_kernel`.
        """
        if not features.volumes:
            return None
        needs = narrow(shading, VolumeFeatures)
        varies = may_vary(features.volume_program)
        reads = not set(GRID_OPS).isdisjoint(features.volume_program.ops)
        return VolumeKernels(
            enter=enter_kernel,
            scatter=volume_kernel(needs, out_of_line),
            cross=cross_kernel(needs.instancing, needs.smooth_normals, needs.curves, needs.moving),
            transmit=transmit_kernel(needs, out_of_line),
            bound=bound_kernel(needs) if varies or (needs.volume_lights and features.volume_program) else None,
            store_numbers=store_numbers if reads else None,
            store_vectors=store_vectors if reads else None,
            inside=inside_kernel if features.volume_lights else None,
        )

    def all(self) -> list[wp.Kernel]:
        """All of them."""
        found = [getattr(self, field.name) for field in dataclasses.fields(self)]
        return [kernel for kernel in found if kernel is not None]


def allocate_state(path_count: int, device: wp.Device) -> MediaState:
    """The state of `path_count` paths."""
    state = MediaState()
    for name, array in MediaState.vars.items():
        setattr(state, name, wp.zeros(path_count, dtype=array.type.dtype, device=device))
    return state


def with_state(shared: VolumeData, path_count: int, bounce_max: int, device: wp.Device) -> VolumeData:
    """`shared`, which all workers read, with the state of one worker's paths."""
    own = VolumeData()
    for name in VolumeData.vars:
        setattr(own, name, getattr(shared, name))
    own.state = allocate_state(path_count, device)
    own.bounce_max = bounce_max
    own.counts = wp.zeros((COUNT_ROWS, COUNTS), dtype=wp.int64, device=device)
    return own


def state_of(volumes: VolumeData | None) -> MediaState:
    """The state of a worker's paths in its `volumes`; an empty one where there are none."""
    return volumes.state if volumes else MediaState()


def begin_counts(volumes: VolumeData | None) -> None:
    """A render begins: what its worker counts begins anew."""
    if volumes:
        volumes.counts.zero_()
