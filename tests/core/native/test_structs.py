"""Tables of NumPy are declared in C++ as they lie in memory."""

import numpy as np

from raybatch_addon.core.native.structs import struct_defines


def test_fields_come_in_order_and_eight_floats_are_a_vector():
    table = np.dtype(
        [("first", "i8"), ("kind", "i4"), ("cost", "f4"), ("boxes", "f4", (3, 2, 8)), ("counts", "i4", (8,))]
    )
    assert struct_defines(TASK=table) == {
        "TASK_FIELDS": "long long first; int kind; float cost; f8u boxes[3][2]; int counts[8];",
        "TASK_BYTES": 8 + 4 + 4 + 4 * 48 + 32,
    }
