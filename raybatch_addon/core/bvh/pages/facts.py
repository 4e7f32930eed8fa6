"""Facts about the pages of a scene, by which it is decided which ones are brought to the device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class PageFacts:
    """Facts about every page; arrays of shape [page_count]."""

    waiting: np.ndarray  # rays that wait for the page, of all workers
    since: np.ndarray  # clock at which the first of them began to wait
    absent: np.ndarray  # bool: neither on the device nor on its way
    evictable: np.ndarray  # bool: on the device, and may leave
    loaded_at: np.ndarray  # clock at which it was loaded last
    left_at: np.ndarray  # clock at which it was evicted last
    served: np.ndarray  # rays that waited for it when it was loaded last
    clock: int  # pages loaded so far
    pool: int  # pages that fit on the device


@dataclass
class PageCounts:
    """Figures of what was moved for one worker, or for several."""

    bytes_copied: int = 0
    loaded: int = 0
    evicted: int = 0
