"""Whether arrays lie in files."""

import mmap

import numpy as np


def is_mapped(array: np.ndarray) -> bool:
    """Whether the memory of `array` is that of a file."""
    part = array
    while isinstance(part, np.ndarray):
        part = part.base
    return isinstance(part, mmap.mmap)
