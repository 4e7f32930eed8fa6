"""Volumes of one worker: the state of its paths in them, and the launches of their stages."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import warp as wp

from ...scene.features import SceneFeatures, narrow
from .cross import cross_kernel, enter_kernel
from .features import VolumeFeatures
from .scatter import volume_kernel
from .table import MediaState, VolumeData
from .transmit import transmit_kernel


@dataclass(frozen=True)
class VolumeKernels:
    """Kernels of the stages of volumes."""

    enter: wp.Kernel
    scatter: wp.Kernel
    cross: wp.Kernel
    transmit: wp.Kernel

    @staticmethod
    def choose(features: SceneFeatures) -> VolumeKernels | None:
        """Those of a scene with `features`; None where there are no volumes."""
        if not features.volumes:
            return None
        needs = narrow(features, VolumeFeatures)
        return VolumeKernels(
            enter_kernel,
            volume_kernel(needs),
            cross_kernel(features.instancing, features.smooth_normals, features.curves, features.moving),
            transmit_kernel(needs),
        )

    def all(self) -> list[wp.Kernel]:
        """All of them."""
        return [getattr(self, field.name) for field in dataclasses.fields(self)]


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
    return own
