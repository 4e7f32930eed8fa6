"""Estimates as kernels: one for each, or one that holds all of them, as with the stages that shade."""

from __future__ import annotations

import functools

import warp as wp

from ...device.kernel import general_options, kernel_options, specialised_out_of_line
from ...displacement.evaluate import make_displace
from ...scene.features import SceneFeatures
from ..scene.shading_data import SceneData
from .lamps import make_lamp_estimate
from .triangles import make_triangle_estimate
from .work import Estimate, EstimateWork
from .world import make_world_estimate


def estimate_kernel(features: SceneFeatures, estimate: Estimate) -> wp.Kernel:
    """Kernel (data, work) of `estimate`, specialised on `features`; that of all estimates, and of displacement, where
    these are of all scenes.
    """
    make = {
        Estimate.TRIANGLES: lambda: make_triangle_estimate(
            features.programs, features.instancing, features.smooth_normals
        ),
        Estimate.WORLD: lambda: make_world_estimate(features.world_program),
        Estimate.LAMPS: lambda: make_lamp_estimate(features.lamp_program),
    }
    if features.programs.apart:
        moves = "vertex_offset" in features.programs.ops
        displace = make_displace(features.programs) if moves else None
        return _kernel_of_all(*(made() for made in make.values()), displace, features.programs.ops)
    return _kernel_of(make[estimate](), specialised_out_of_line())


@functools.cache
def _kernel_of(function: wp.Function, out_of_line: bool) -> wp.Kernel:
    def estimate(data: SceneData, work: EstimateWork):
        function(data, work, wp.tid())

    estimate.__name__ = estimate.__qualname__ = f"{function.func.__name__}_kernel"
    return wp.kernel(estimate, **kernel_options(out_of_line))


@functools.cache
def _kernel_of_all(
    triangles: wp.Function, world: wp.Function, lamps: wp.Function, displace: wp.Function | None, of: tuple[str, ...]
) -> wp.Kernel:
    @wp.kernel(**general_options("estimates", of))
    def all_estimates(data: SceneData, work: EstimateWork):
        i = wp.tid()
        if work.estimate == wp.static(int(Estimate.TRIANGLES)):
            triangles(data, work, i)
        elif work.estimate == wp.static(int(Estimate.WORLD)):
            world(data, work, i)
        elif work.estimate == wp.static(int(Estimate.LAMPS)):
            lamps(data, work, i)
        elif wp.static(displace is not None):
            displace(data.nodes, work.vertices, i)

    return all_estimates
