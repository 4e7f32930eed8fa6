"""Ops that make closures without facets, and what all such ops share.

Each gets its weight first: the product of its colour and of all factors above it in the graph.
"""

import warp as wp

from ....scene.description import ClosureKind
from ....shading.bsdf.materials import IOR_RANGE, ClosureRecord, new_closure
from ...op import NodeData, closure_op, vector
from ...point import ShadingPoint

_IOR_MOST = IOR_RANGE[1]


@wp.func
def usable_weight(weight: wp.vec3) -> wp.vec3:
    """`weight` with 0 for channels that are negative or not finite."""
    result = wp.vec3(0.0)
    for i in range(3):
        if weight[i] > 0.0 and weight[i] < wp.inf:
            result[i] = weight[i]
    return result


@wp.func
def is_black(weight: wp.vec3) -> bool:
    """Whether a closure of this weight is invisible."""
    return weight[0] == 0.0 and weight[1] == 0.0 and weight[2] == 0.0


@wp.func
def begins(weight: wp.vec3, closures: wp.array(dtype=ClosureRecord), count: int) -> bool:
    """Whether a closure of this weight joins the `count` that `closures` has: it is visible, and there is room."""
    return not is_black(weight) and count < closures.shape[0]


@wp.func
def unit_number(x: float) -> float:
    """`x` clamped to [0, 1]; 0 for NaN."""
    result = float(0.0)
    if x > 0.0:
        result = wp.min(x, 1.0)
    return result


@wp.func
def unit_color(c: wp.vec3) -> wp.vec3:
    """`c` with `unit_number` of each channel."""
    return wp.vec3(unit_number(c[0]), unit_number(c[1]), unit_number(c[2]))


@wp.func
def usable_index(ior: float, least: float) -> float:
    """An index of refraction from `least` to the largest allowed; `least` for NaN."""
    result = least
    if ior > least:
        result = wp.min(ior, wp.static(_IOR_MOST))
    return result


@wp.func
def usable_normal(normal: wp.vec3) -> wp.vec3:
    """`normal` as a unit vector; 0, which stands for the surface's own, if it has no direction."""
    square = wp.dot(normal, normal)
    result = wp.vec3(0.0)
    if square > 1.0e-30 and square < 1.0e30:
        result = normal / wp.sqrt(square)
    return result


@wp.func
def simple_closure(
    kind: int, weight: wp.vec3, normal: wp.vec3, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """Append a closure that has nothing but a weight and a normal; returns the new count."""
    w = usable_weight(weight)
    if not begins(w, closures, count):
        return count
    record = new_closure(kind, w)
    record.normal = usable_normal(normal)
    closures[count] = record
    return count + 1


@closure_op("emission", "v")
@wp.func
def emission(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Emission: weight, which is the radiance on both sides [W/(m² sr)]."""
    return simple_closure(
        wp.static(int(ClosureKind.EMISSION)), vector(data, stack, pc + 1), wp.vec3(0.0), closures, count
    )


@closure_op("transparent", "v")
@wp.func
def transparent(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Straight passage of light: weight."""
    return simple_closure(
        wp.static(int(ClosureKind.TRANSPARENT)), vector(data, stack, pc + 1), wp.vec3(0.0), closures, count
    )


@closure_op("holdout", "v")
@wp.func
def holdout(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Hole in the picture: weight."""
    return simple_closure(
        wp.static(int(ClosureKind.HOLDOUT)), vector(data, stack, pc + 1), wp.vec3(0.0), closures, count
    )


@closure_op("diffuse", "vv")
@wp.func
def diffuse(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Reflection by Lambert's law: weight, normal."""
    return simple_closure(
        wp.static(int(ClosureKind.DIFFUSE)), vector(data, stack, pc + 1), vector(data, stack, pc + 2), closures, count
    )


@closure_op("translucent", "vv")
@wp.func
def translucent(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Transmission by Lambert's law, to the other side: weight, normal."""
    kind = wp.static(int(ClosureKind.TRANSLUCENT))
    return simple_closure(kind, vector(data, stack, pc + 1), vector(data, stack, pc + 2), closures, count)


@closure_op("ray_portal", "vivv")
@wp.func
def ray_portal(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Passage to elsewhere: weight, 1 where a position is given, position [m], direction (0: straight on).

    A position that is not finite swallows the light.
    """
    w = usable_weight(vector(data, stack, pc + 1))
    position = vector(data, stack, pc + 3)
    if not begins(w, closures, count) or not wp.dot(position, position) < wp.inf:
        return count
    record = new_closure(wp.static(int(ClosureKind.RAY_PORTAL)), w)
    record.distribution = data.code[pc + 2]
    record.edge = position
    record.tangent = usable_normal(vector(data, stack, pc + 4))
    closures[count] = record
    return count + 1
