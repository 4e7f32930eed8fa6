"""What the table of lights has of emissive triangles: arrays that are kept while these are the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from ....device.bulk import digest_of
from ..emitters import EmissiveTriangles

KeepArrays = Callable[[tuple[list[np.ndarray], object], Callable[[], list[wp.array]]], list[wp.array]]

# Arrays of a `LightTable` that follow from emissive triangles and from what instances are seen by
_NAMES = (
    "triangle_instance",
    "triangle_primitive",
    "triangle_radiance",
    "triangle_program",
    "instance_first",
    "instance_visibility",
)


def set_triangles(
    table: Any, triangles: EmissiveTriangles, visibility: np.ndarray, device: wp.Device, keep: KeepArrays
) -> None:
    """Give the `LightTable` `table` the arrays of `triangles`, and what rays see each instance (`visibility`). `keep`
    returns arrays that are made, or those that were made before of the same frozen arrays and values.
    """
    frozen = [triangles.radiance] if len(triangles) else []
    # the same triangles may be those of instances with other numbers
    values = device.alias, digest_of([visibility, triangles.instance_first]) if len(triangles) else b""
    arrays = keep((frozen, values), lambda: _upload_triangles(triangles, visibility, device))
    for name, array in zip(_NAMES, arrays, strict=True):
        setattr(table, name, array)


def triangle_arrays(table: Any) -> list[wp.array]:
    """What `table` has of emissive triangles, and of instances where there are some."""
    return [getattr(table, name) for name in _NAMES]


def _upload_triangles(triangles: EmissiveTriangles, visibility: np.ndarray, device: wp.Device) -> list[wp.array]:
    """Arrays in the order of `_NAMES`; `visibility` is that of instances to rays."""
    program = triangles.program if triangles.program.any() else triangles.program[:0]
    first, seen = triangles.instance_first, visibility
    if len(triangles) == 0:
        first = seen = np.zeros(0, np.int32)
    values = triangles.instance, triangles.primitive, triangles.radiance, program, first, seen
    # millions of numbers that nobody writes to: on the CPU they are where they are
    return [
        wp.array(each, dtype=wp.vec3 if each is triangles.radiance else int, device=device, copy=False)
        for each in values
    ]
