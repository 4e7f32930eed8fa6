"""Stages of the CPU builder as one kernel: each does one step for some of the build's tasks or jobs, on one thread.

One kernel, because the C++ that stages share (`native/binary`) is compiled once that way. CPU only: CUDA devices have a
builder of their own.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import warp as wp

from ....device.kernel import KERNEL_OPTIONS
from ....native.build import native_source
from ....native.structs import struct_defines
from ..binary import DEPTH_MAX

INDEX_BIAS = 127 << 23
"""Added to the bits of a record's triangle (`native/binary/records.h`)."""
BINS_MAX = 32
"""Bins along an axis, at most."""


class Stage(IntEnum):
    """The steps of a build."""

    RECORDS = 0
    BIN = 1
    CHOOSE = 2
    SPATIAL_BIN = 3
    SPATIAL_CHOOSE = 4
    SPATIAL_COUNT = 5
    PARTITION = 6
    SUBTREE = 7
    GATHER = 8


class Split(IntEnum):
    """The kind of a task: a leaf, or how it was split."""

    LEAF = 0
    HALF = 1  # halved by index
    OBJECT = 2  # split between two bins
    LISTED = 3  # split between two records; `bin` lists the right side, a bit each
    SPATIAL = 4  # split at a plane that cuts triangles


TASK = np.dtype(
    [
        ("first", "i8"),
        ("count", "i8"),
        ("capacity", "i8"),
        ("left_count", "i8"),
        ("right_count", "i8"),
        ("node_count", "i8"),
        ("reference_count", "i8"),
        ("node_first", "i8"),
        ("reference_first", "i8"),
        ("job_first", "i4"),
        ("job_end", "i4"),
        ("depth", "i4"),
        ("buffer", "i4"),
        ("node", "i4"),
        ("kind", "i4"),
        ("axis", "i4"),
        ("bin", "i4"),
        ("leaf_count", "i4"),
        ("leaf_largest", "i4"),
        ("depth_max", "i4"),
        ("spatial", "i4"),
        ("cost", "f4"),
        ("position", "f4"),
        ("left_weight", "f4"),
        ("right_weight", "f4"),
        ("box", "f4", 8),
        ("middle", "f4", 8),
        ("left_box", "f4", 8),
        ("right_box", "f4", 8),
    ]
)
"""A node on its way: references from `first` on of `buffer`, the split that was chosen, and figures of a finished
subtree.
"""

JOB = np.dtype(
    [
        ("first", "i8"),
        ("count", "i8"),
        ("left", "i8"),
        ("right", "i8"),
        ("left_count", "i8"),
        ("right_count", "i8"),
        ("task", "i8"),
        ("bounds", "f4", (4, 8)),
    ]
)
"""A chunk of a task\'s references; `bounds` are box and middle of its left and right part."""

BINS = np.dtype([("bins", "i4"), ("box", "f4", (3, BINS_MAX, 8)), ("count", "i4", (3, BINS_MAX))])
"""Boxes and counts of records by axis and bin; `bins` are in use."""

SPATIAL_BINS = np.dtype(
    [("bins", "i4"), ("box", "f4", (3, BINS_MAX, 8)), ("enter", "i4", (3, BINS_MAX)), ("leave", "i4", (3, BINS_MAX))]
)
"""Boxes of parts of triangles by axis and bin, and the references that begin and end there."""


@wp.struct
class BuildArrays:
    """All arrays of a build; `capacity` is the references that there is room for."""

    positions: wp.array2d(dtype=float)  # [vertex_count, 3]
    triangles: wp.array2d(dtype=int)  # [triangle_count, 3]
    records_0: wp.array2d(dtype=float)  # [capacity, 8]
    records_1: wp.array2d(dtype=float)  # [capacity, 8]
    nodes: wp.array2d(dtype=float)  # a subtree's begin at twice its first reference, [2 * capacity, 8]
    references: wp.array(dtype=int)  # [capacity]
    bins: wp.array(dtype=float)  # those of each job
    tree_nodes: wp.array2d(dtype=float)  # the result
    tree_references: wp.array(dtype=int)


@wp.struct
class BuildNumbers:
    """The options that native code reads."""

    leaf_group: int
    leaf_max: int
    traversal_cost: float
    group_inverse: float  # 1 / leaf_group, rounded upwards
    split_overlap: float
    root_area: wp.float64


@wp.func_native(
    native_source(
        "binary/records.h",
        "binary/sah.h",
        "binary/spatial.h",
        "binary/stages.h",
        device="cpu",
        INDEX_BIAS=INDEX_BIAS,
        BINS_MAX=BINS_MAX,
        DEPTH_MAX=DEPTH_MAX,
        **struct_defines(TASK=TASK, JOB=JOB, BINS=BINS, SPATIAL_BINS=SPATIAL_BINS),
        **{each.name: each.value for each in (*Split, *Stage)},
    )
)
def build_items(
    arrays: BuildArrays,
    numbers: BuildNumbers,
    task_bytes: wp.array(dtype=wp.uint8),
    job_bytes: wp.array(dtype=wp.uint8),
    stage: int,
    first: int,
    end: int,
): ...


@wp.kernel(**KERNEL_OPTIONS)
def build_kernel(
    arrays: BuildArrays,
    numbers: BuildNumbers,
    task_bytes: wp.array(dtype=wp.uint8),
    job_bytes: wp.array(dtype=wp.uint8),
    stage: int,
    first: int,
    end: int,
):
    """One stage of the build for tasks or jobs first..end, on one thread."""
    build_items(arrays, numbers, task_bytes, job_bytes, stage, first, end)
