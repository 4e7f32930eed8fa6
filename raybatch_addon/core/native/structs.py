"""NumPy's tables as C++ and Warp have them, so that their fields are listed once."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

# Copies what has a name to a device: (name, values, type of Warp, device); for records see `upload_records`
Upload = Callable[[str, np.ndarray, Any, wp.Device], wp.array]

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


@functools.cache
def record_type(struct: Any) -> np.dtype:
    """NumPy's type of records that are laid out as the Warp `struct`; Warp alone would make it at each use."""
    return np.dtype(struct.numpy_dtype())


def upload_records(records: np.ndarray, struct: Any, device: wp.Device) -> wp.array:
    """A copy on `device` of `records`, whose type is `record_type(struct)`; shape [n]."""
    records = np.ascontiguousarray(records)
    return _copied(records.ctypes.data, len(records), struct, device)


def upload_struct(value: Any, device: wp.Device) -> wp.array:
    """A copy on `device` of one instance of a Warp struct; shape [1]. The arrays in it have to be kept by themselves.

    Warp makes it from a list by way of a NumPy type of all its fields, which takes a millisecond or more.
    """
    return _copied(ctypes.addressof(value.__ctype__()), 1, value._cls, device)


def upload_anew(_name: str, values: np.ndarray, dtype: Any, device: wp.Device) -> wp.array:
    """A new array on `device` of `values`, of numbers or records: the plain `Upload`."""
    if values.dtype.names:
        return upload_records(values, dtype, device)
    return wp.array(values, dtype=dtype, device=device)


def to_numpy(array: wp.array) -> np.ndarray:
    """What is in `array`: on the CPU the same memory; of a CUDA device a copy, as its stream has it by now.

    Warp's own method makes the default stream that of the device meanwhile, for all threads, and for good where two
    threads are at it side by side: then another device's thread records no event there (`copied_to`).
    """
    device = array.device
    if device.is_cpu:
        return array.numpy()
    host = wp.empty(array.shape, dtype=array.dtype, device="cpu")
    if array.size:
        wp.copy(host, array)
        wp.synchronize_event(device.stream.record_event())
    return host.numpy()


def bytes_of_struct(value: Any) -> np.ndarray:
    """What one instance of a Warp struct is in memory, uint8; the arrays in it are their addresses."""
    made = value.__ctype__()
    return np.frombuffer(ctypes.string_at(ctypes.addressof(made), ctypes.sizeof(made)), np.uint8)


def arrays_in(value: Any) -> dict[int, int]:
    """Bytes of all arrays in `value` by their addresses: in Warp's structs, in trees, and in lists of such things."""
    if isinstance(value, wp.array):
        return {value.ptr: int(value.capacity)} if value.capacity else {}
    if isinstance(value, wp.Bvh):
        inner = [value.lowers, value.uppers]
    elif isinstance(value, list):
        inner = value
    else:
        struct = getattr(value, "_cls", None)
        inner = [getattr(value, name) for name in struct.vars] if struct is not None else []
    return {address: size for each in inner for address, size in arrays_in(each).items()}


def copied_to(array: wp.array, device: wp.Device) -> wp.array:
    """A copy of `array` on `device`.

    Warp copies on the stream of `device`, and has another device wait for that before it overwrites or frees anything.
    Here the copy also waits for what that device was told before.
    """
    if array.device.is_cuda and device.is_cuda and array.device != device:
        device.stream.wait_event(array.device.stream.record_event())
    return wp.clone(array, device=device)


def copied_by_host(array: wp.array, device: wp.Device) -> wp.array:
    """The same by way of the host between two devices, for arrays of some megabytes where both have a lot to do.

    In `copied_to` each device's stream waits for the other's. Here the calling thread alone waits for both.
    """
    if array.device == device or array.device.is_cpu:
        return wp.clone(array, device=device)
    if array.size == 0:
        return wp.empty(array.shape, dtype=array.dtype, device=device)
    return wp.array(to_numpy(array), dtype=array.dtype, device=device)


def struct_on(value: Any, device: wp.Device) -> Any:
    """One instance of a Warp struct with copies on `device` of all arrays in it, and in structs of it."""
    made = value._cls()
    for name in value._cls.vars:
        each = getattr(value, name)
        if isinstance(each, wp.array):
            each = copied_by_host(each, device)
        elif hasattr(each, "_cls"):
            each = struct_on(each, device)
        setattr(made, name, each)
    return made


def _copied(address: int, count: int, struct: Any, device: wp.Device) -> wp.array:
    made = wp.empty(count, dtype=struct, device=device)
    if count:
        wp.copy(made, wp.array(ptr=address, dtype=struct, shape=count, device="cpu"))
    return made


def _field(name: str, dtype: np.dtype) -> str:
    """The declaration of one field."""
    kind, shape = _TYPES[dtype.base.name], dtype.shape
    if kind == "float" and shape[-1:] == (_LANES,):
        kind, shape = "f8u", shape[:-1]
    return f"{kind} {name}{''.join(f'[{size}]' for size in shape)};"
