"""The joints of the tree over emitters, and what kernels do to the boxes that are joined."""

import warp as wp

from ....device.kernel import KERNEL_OPTIONS


@wp.struct
class Joints:
    """A binary tree over emitters: leaves [0, leaf_count) first, inner node `leaf_count + k` at k."""

    leaf_count: int
    low: wp.array(dtype=wp.vec3)  # of boxes of all nodes, once they are joined [m]
    high: wp.array(dtype=wp.vec3)
    children: wp.array(dtype=wp.vec2i)
    which: wp.array(dtype=int)  # which emitter a leaf is


@wp.kernel(**KERNEL_OPTIONS)
def widen_leaves_kernel(low: wp.array(dtype=wp.vec3), high: wp.array(dtype=wp.vec3), half: float):
    """Boxes reach at least `half` [m] to each side of their middle."""
    i = wp.tid()
    middle = 0.5 * low[i] + 0.5 * high[i]
    reach = wp.vec3(half, half, half)
    low[i] = wp.min(low[i], middle - reach)
    high[i] = wp.max(high[i], middle + reach)
