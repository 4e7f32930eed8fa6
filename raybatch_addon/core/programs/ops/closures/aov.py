"""The op that writes passes of materials (AOVs)."""

import warp as wp

from ....shading.bsdf.materials import AOV, ClosureRecord, new_closure
from ...op import NodeData, closure_op, vector
from ...point import ShadingPoint


@closure_op("aov", "vi", foldable=False)
@wp.func
def aov(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """A value of a pass: the value, the pass's number among those of materials.

    It comes before all closures in a program, behind the surface's normal, and its record is no closure.
    """
    value = vector(data, stack, pc + 1)
    if count >= closures.shape[0] or not wp.isfinite(wp.dot(value, value)):
        return count
    closures[count] = new_closure(wp.static(AOV), value)
    closures[count].distribution = data.code[pc + 2]
    return count + 1
