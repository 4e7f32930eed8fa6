"""NumPy's tables as C++ has them, so that their fields are listed once."""

from __future__ import annotations

import numpy as np

_TYPES = {"int64": "long long", "int32": "int", "float32": "float", "uint8": "unsigned char"}
_LANES = 8  # floats of a box


def struct_defines(**tables: np.dtype) -> dict[str, str | int]:
    """Macros for `native_source`: of each table NAME its fields, `NAME_FIELDS`, and its size, `NAME_BYTES`.

    Eight floats, the last dimension of a field, are one `f8u`. A `struct` of the fields whose size is NAME_BYTES has no
    gaps, so that each field lies where NumPy has it.
    """
    defines = {}
    for name, table in tables.items():
        defines[f"{name}_FIELDS"] = " ".join(_field(field, table[field]) for field in table.names)
        defines[f"{name}_BYTES"] = table.itemsize
    return defines


def _field(name: str, dtype: np.dtype) -> str:
    """The declaration of one field."""
    kind, shape = _TYPES[dtype.base.name], dtype.shape
    if kind == "float" and shape[-1:] == (_LANES,):
        kind, shape = "f8u", shape[:-1]
    return f"{kind} {name}{''.join(f'[{size}]' for size in shape)};"
