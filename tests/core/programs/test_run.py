"""Interpreters of other ops are other kernels."""

import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.op import NodeData
from raybatch_addon.core.programs.point import ShadingPoint
from raybatch_addon.core.programs.run import make_run
from raybatch_addon.core.scene.program import ProgramFeatures
from raybatch_addon.core.shading.bsdf.materials import ClosureRecord


def kernel_of(*ops):
    run = make_run(ProgramFeatures(ops, 16, 1))

    @wp.kernel(**KERNEL_OPTIONS)
    def probe(data: NodeData, out: wp.array(dtype=float)):
        stack = wp.zeros(16, dtype=float)
        closures = wp.zeros(1, dtype=ClosureRecord)
        run(data, stack, 0, ShadingPoint(), closures)
        out[0] = stack[0]

    return probe


def test_kernels_of_other_ops_are_not_taken_for_the_same():
    several = [
        ("emission", "gamma", "math"),
        ("emission", "invert", "math"),
        ("diffuse", "gamma", "math"),
        ("gamma", "math"),
        ("emission",),
    ]
    assert len({kernel_of(*ops).module.name for ops in several}) == len(several)
    assert kernel_of(*several[0]).module.name == kernel_of(*several[0]).module.name
