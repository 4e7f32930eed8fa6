"""A tree over the boxes of lights that rays can meet, with many boxes in each block.

Lights lie in blocks of as many as are compared at once, as do the blocks in blocks above them: all are full but the
last, so that the tree is as low as it can be and lies in few cache lines (Lee and Lee 2003, "OMT: overlap minimizing
top-down bulk loading algorithm for R-tree").
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ....native.build import native_source
from ....native.structs import record_type, upload_records

BOXES_WIDE = 16
# Blocks of blocks that number all that an int can
_LEVELS = 8
# A direction's component is at least this, so that no distance is 0 times infinity; boxes are thicker than that bends
_COMPONENT_MIN = 1e-18
_FLOAT = np.finfo(np.float32)

_floats = wp.types.vector(BOXES_WIDE, wp.float32)
_ints = wp.types.vector(BOXES_WIDE, wp.int32)


@wp.struct
class BoxBlock:
    """Boxes side by side; the first block of a tree is its top. What is there comes first."""

    low_x: _floats  # [m]
    low_y: _floats
    low_z: _floats
    high_x: _floats
    high_y: _floats
    high_z: _floats
    last: _ints  # number of the last item within the box; -1: there is no box
    below: _ints  # the block below; less than 0: the box is that of one item, the light of number -1 - that


@wp.func_native(native_source("lights/next_met.h", WIDTH=BOXES_WIDE, LEVELS=_LEVELS))
def _next_entered(
    tree: wp.array(dtype=BoxBlock), origin: wp.vec3, inverse: wp.vec3, t_max: float, before: int
) -> int: ...


@wp.func
def _reciprocal(component: float) -> float:
    if wp.abs(component) < _COMPONENT_MIN:
        return wp.where(component < 0.0, -1.0, 1.0) / _COMPONENT_MIN
    return 1.0 / component


@wp.func
def next_met(tree: wp.array(dtype=BoxBlock), origin: wp.vec3, direction: wp.vec3, t_max: float, before: int) -> int:
    """The next item after `before`, -1 at first, whose box a ray enters before `t_max`; -1: there is none."""
    inverse = wp.vec3(_reciprocal(direction[0]), _reciprocal(direction[1]), _reciprocal(direction[2]))
    return _next_entered(tree, origin, inverse, t_max, before)


@wp.func
def light_of(tree: wp.array(dtype=BoxBlock), leaf_first: int, item: int) -> int:
    """Number of the light of an item; `leaf_first`: the first block of items."""
    return -1 - tree[leaf_first + item // wp.static(BOXES_WIDE)].below[item % wp.static(BOXES_WIDE)]


def box_tree(low: np.ndarray, high: np.ndarray, lights: np.ndarray, device: wp.Device) -> tuple[wp.array, int]:
    """The tree over boxes, `BoxBlock`, and the number of its first block of items.

    `low`, `high`: corners of the boxes, float32, shape [n, 3]; `lights`: numbers of their lights, int, shape [n].
    """
    order = np.arange(len(low))
    _sort(0.5 * low.astype(np.float64) + 0.5 * high, order)
    boxes = low[order], high[order], np.arange(len(low))
    levels = [boxes]  # corners of boxes, and the number of the last item within each; those of items first
    while len(boxes[2]) > BOXES_WIDE:
        first = np.arange(0, len(boxes[2]), BOXES_WIDE)
        boxes = tuple(np.maximum.reduceat(each, first) for each in (-boxes[0], *boxes[1:]))
        boxes = -boxes[0], *boxes[1:]
        levels.append(boxes)
    blocks, block_count, leaf_first = [], 0, 0
    for depth, (lows, highs, last) in enumerate(levels[::-1]):
        leaf_first = block_count  # of the last level, in the end
        block_count += -(-len(last) // BOXES_WIDE)
        is_above = depth + 1 < len(levels)
        below = block_count + np.arange(len(last)) if is_above else -1 - lights[order]
        blocks.append(_blocks_of(lows, highs, last, below))
    return upload_records(np.concatenate(blocks), BoxBlock, device), leaf_first


def _blocks_of(low: np.ndarray, high: np.ndarray, last: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Blocks of boxes with these numbers, `BoxBlock`."""
    fields = {
        f"{name}_{axis}": side[:, k] for name, side in (("low", low), ("high", high)) for k, axis in enumerate("xyz")
    }
    records = np.zeros(-(-len(last) // BOXES_WIDE), record_type(BoxBlock))
    for name, values in (fields | {"last": last, "below": below}).items():
        padded = np.full(records.size * BOXES_WIDE, -1, records[name].dtype)
        padded[: len(values)] = values
        records[name] = padded.reshape(records[name].shape)
    return records


def _sort(middle: np.ndarray, order: np.ndarray) -> None:
    """Sort `order`, numbers of boxes with these middles, in place: what is near lies in one block, on all levels."""
    parts = [order]
    while parts:
        part = parts.pop()
        if len(part) <= BOXES_WIDE:
            continue
        full = BOXES_WIDE ** int(np.ceil(np.log(len(part)) / np.log(BOXES_WIDE) - 1e-9) - 1)  # items of a box above
        half = max(round(len(part) / full / 2), 1) * full
        at = middle[part]
        axis = int(np.argmax(at.max(0) - at.min(0)))
        part[:] = part[np.argsort(at[:, axis], kind="stable")]  # not by parts, whose order is the processor's
        parts += [part[:half], part[half:]]
