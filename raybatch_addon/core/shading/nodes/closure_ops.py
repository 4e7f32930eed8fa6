"""Ops that make closures. Each gets its weight first: the product of its colour and of all factors above it in the graph."""

import warp as wp

from ...scene.description import ClosureKind
from ..materials import ClosureRecord
from .op import NodeData, closure_op, vector
from .point import ShadingPoint


@wp.func
def usable_weight(weight: wp.vec3) -> wp.vec3:
    """`weight` without negative channels and numbers that are not finite: none of them is light."""
    result = wp.vec3(0.0)
    for i in range(3):
        if weight[i] > 0.0 and weight[i] < wp.inf:
            result[i] = weight[i]
    return result


@wp.func
def is_black(weight: wp.vec3) -> bool:
    """Whether nothing of a closure of this weight is seen."""
    return weight[0] == 0.0 and weight[1] == 0.0 and weight[2] == 0.0


@closure_op("emission", "v")
@wp.func
def emission(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int) -> int:
    """Emits its weight as radiance, on both sides [W/(m² sr)]."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    record = ClosureRecord()
    record.kind = wp.static(int(ClosureKind.EMISSION))
    record.weight = weight
    closures[count] = record
    return count + 1


@closure_op("transparent", "v")
@wp.func
def transparent(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int) -> int:
    """Lets light pass straight on, times its weight."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    record = ClosureRecord()
    record.kind = wp.static(int(ClosureKind.TRANSPARENT))
    record.weight = weight
    closures[count] = record
    return count + 1


@closure_op("diffuse", "vn")
@wp.func
def diffuse(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int) -> int:
    """Reflects by Lambert's law."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    record = ClosureRecord()
    record.kind = wp.static(int(ClosureKind.DIFFUSE))
    record.weight = weight
    closures[count] = record
    return count + 1
