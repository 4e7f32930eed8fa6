"""Ops that make rough diffuse closures and cloth."""

import warp as wp

from ...scene.description import ClosureKind
from ..materials import ClosureRecord, new_closure
from .closure_ops import is_black, unit_color, unit_number, usable_normal, usable_weight
from .op import NodeData, closure_op, number, vector
from .point import ShadingPoint

# Grooves that are flatter than this are none
_ROUGHNESS_LEAST = 1e-5


@wp.func
def _soft_closure(
    data: NodeData, stack: wp.array(dtype=float), pc: int, kind: int, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    w = usable_weight(vector(data, stack, pc + 1))
    if is_black(w) or count >= closures.shape[0]:
        return count
    record = new_closure(kind, w)
    record.roughness = unit_number(number(data, stack, pc + 2))
    record.normal = usable_normal(vector(data, stack, pc + 3))
    closures[count] = record
    return count + 1


@closure_op("rough_diffuse", "vvnv")
@wp.func
def rough_diffuse(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """Oren and Nayar's: weight, colour of bounces between grooves, roughness, normal. Without roughness it is Lambert's law."""
    weight = usable_weight(vector(data, stack, pc + 1))
    if is_black(weight) or count >= closures.shape[0]:
        return count
    roughness = unit_number(number(data, stack, pc + 3))
    record = new_closure(wp.static(int(ClosureKind.ROUGH_DIFFUSE)), weight)
    record.colour = unit_color(vector(data, stack, pc + 2))
    record.roughness = roughness
    record.normal = usable_normal(vector(data, stack, pc + 4))
    if roughness < wp.static(_ROUGHNESS_LEAST):
        record.kind = wp.static(int(ClosureKind.DIFFUSE))
    closures[count] = record
    return count + 1


@closure_op("sheen", "vnv")
@wp.func
def sheen(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """A layer of fibres: weight, roughness, normal."""
    return _soft_closure(data, stack, pc, wp.static(int(ClosureKind.SHEEN)), closures, count)


@closure_op("velvet", "vnv")
@wp.func
def velvet(
    data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """Ashikhmin's velvet: weight, sigma, normal."""
    return _soft_closure(data, stack, pc, wp.static(int(ClosureKind.VELVET)), closures, count)
