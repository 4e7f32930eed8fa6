"""The end of displacement programs, which run at vertices and in no kernel that shades."""

import warp as wp

from ....shading.bsdf.materials import SURFACE_NORMAL, ClosureRecord, new_closure
from ...op import NodeData, closure_op, vector
from ...point import ShadingPoint


@closure_op("vertex_offset", "v", foldable=False)
@wp.func
def vertex_offset(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """How far a vertex is moved in the world [m]: the normal of a record that is no closure."""
    if count >= closures.shape[0]:
        return count
    closures[count] = new_closure(wp.static(SURFACE_NORMAL), wp.vec3(0.0))
    closures[count].normal = vector(data, stack, pc + 1)
    return count + 1
