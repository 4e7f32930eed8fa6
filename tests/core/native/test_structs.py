"""Tables of NumPy are declared in C++ as they lie in memory, and arrays of a device are read."""

import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import warp as wp

from raybatch_addon.core.film.mattes import MatteEntry
from raybatch_addon.core.native import structs
from raybatch_addon.core.native.structs import record_type, struct_defines, to_numpy, upload_records
from tests.support.under_test import DEVICE

PACKAGE = Path(structs.__file__).parents[2]


def test_fields_come_in_order_and_eight_floats_are_a_vector():
    table = np.dtype(
        [("first", "i8"), ("kind", "i4"), ("cost", "f4"), ("boxes", "f4", (3, 2, 8)), ("counts", "i4", (8,))]
    )
    assert struct_defines(TASK=table) == {
        "TASK_FIELDS": "long long first; int kind; float cost; f8u boxes[3][2]; int counts[8];",
        "TASK_BYTES": 8 + 4 + 4 + 4 * 48 + 32,
    }


def test_arrays_are_read_as_they_are():
    rows = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    vectors = wp.array(rows, dtype=wp.vec3, device=DEVICE)
    assert np.array_equal(to_numpy(vectors), rows)
    assert np.array_equal(to_numpy(vectors[:, 1:3]), rows[:, 1:3])  # does not lie in one piece
    assert to_numpy(vectors[:, :0]).shape == (2, 0, 3)
    assert to_numpy(wp.empty((0, 4), dtype=wp.int64, device=DEVICE)).shape == (0, 4)
    records = np.zeros(3, record_type(MatteEntry))
    records[records.dtype.names[0]] = [1, 2, 3]
    assert np.array_equal(to_numpy(upload_records(records, MatteEntry, wp.get_device(DEVICE))), records)


def test_nothing_else_reads_arrays_of_a_device():
    """Warp's own way changes the stream of a device for all threads."""
    found = {each for each in PACKAGE.rglob("*.py") if re.search(r"\.numpy\(\)|ScopedStream", each.read_text())}
    assert found == {Path(structs.__file__)}


def test_threads_that_read_leave_the_device_its_stream():
    device = wp.get_device(DEVICE)
    stream = device.stream if device.is_cuda else None
    arrays = [wp.full(1 << 16, i, dtype=int, device=device) for i in range(4)]

    def read(i: int) -> bool:
        own = [device.is_cpu or device.stream is stream, bool((to_numpy(arrays[i % 4]) == i % 4).all())]
        return all(own)

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(read, range(400)))
    assert device.is_cpu or device.stream is stream
