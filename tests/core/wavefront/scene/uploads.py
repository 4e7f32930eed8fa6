"""Counts of what a device gets: bytes from the host, and launches of kernels."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import warp as wp


@dataclass
class Uploads:
    """What was counted since the last `clear`."""

    bytes: int = 0
    launches: Counter[str] = field(default_factory=Counter)  # by kernel
    largest: list[tuple[int, str]] = field(default_factory=list)  # bytes, and the type of the array

    def clear(self) -> None:
        """Begin anew."""
        self.bytes = 0
        self.launches.clear()
        self.largest.clear()

    def add(self, array: wp.array, size: int) -> None:
        """`size` bytes of the host are now in `array`."""
        self.bytes += size
        self.largest = sorted([*self.largest, (size, f"{array.dtype} {array.shape}")], key=lambda each: -each[0])[:12]


def counted_uploads(monkeypatch) -> Uploads:
    """Counts from now on.

    On the CPU what is made of NumPy's arrays counts as on another device, whether it is copied there or not. What is
    made for the CPU by its name, or of an address, is no upload but the source of one.
    """
    counted, sources, made_within = Uploads(), {}, [0]  # an array is copied into by what makes it
    make, copy, launch = wp.array.__init__, wp.copy, wp.launch

    def init(self, *args, **kwargs):
        made_within[0] += 1
        try:
            make(self, *args, **kwargs)
        finally:
            made_within[0] -= 1
        if made_within[0]:
            return
        data = args[0] if args else kwargs.get("data")
        of_host = isinstance(kwargs.get("device"), str) and kwargs["device"] == "cpu"
        if (data is not None and of_host) or (kwargs.get("ptr") is not None and of_host):
            sources[id(self)] = self
        elif isinstance(data, (np.ndarray, list, tuple)):
            counted.add(self, int(self.capacity))

    def copied(dest, src, dest_offset=0, src_offset=0, count=0, stream=None):
        if sources.pop(id(src), None) is not None and not made_within[0]:
            counted.add(dest, (count or src.size) * wp.types.type_size_in_bytes(src.dtype))
        copy(dest, src, dest_offset, src_offset, count, stream)

    def launched(kernel, *args, **kwargs):
        counted.launches[kernel.key.split("__")[0]] += 1
        return launch(kernel, *args, **kwargs)

    monkeypatch.setattr(wp.array, "__init__", init)
    monkeypatch.setattr(wp, "copy", copied)
    monkeypatch.setattr(wp, "launch", launched)
    return counted
