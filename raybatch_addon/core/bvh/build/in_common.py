"""The mesh trees of a scene that several devices render together: built by one of them, and copied to the others.

Building is launches and waits of one tree after another, which threads of several devices would do side by side, and
hold each other up: they share Python's lock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future
from dataclasses import replace

import warp as wp

from ...device.devices import is_alike
from ...native.structs import copied_to
from .mesh_tree import MeshTree

_Waiting = list[tuple[wp.Device, Future[list[MeshTree] | None]]]


class TreesInCommon:
    """The mesh trees of one scene for `devices` of a render, each of which asks on a thread of its own."""

    def __init__(self, devices: Sequence[wp.Device]):
        self._devices, self._lock = devices, threading.Lock()
        self._waiting: dict[Hashable, _Waiting] = {}  # for trees that are being built, by what was asked for

    def get(self, device: wp.Device, kind: Hashable, build: Callable[[], list[MeshTree]]) -> list[MeshTree]:
        """Trees on `device`: what `build` makes, or a copy of what another device of the same model makes, where that
        is building trees of this `kind` when they are asked for. They are the caller's.

        Raises what `build` raises. Where the other device's fails, or the copy does, `build` is tried.
        """
        if device.is_cpu:  # there are no two of them
            return build()
        key = kind, next(i for i, each in enumerate(self._devices) if is_alike(each, device))
        copied: Future[list[MeshTree] | None] = Future()
        with self._lock:
            is_first = key not in self._waiting
            waiting = self._waiting.setdefault(key, [])
            if not is_first:
                waiting.append((device, copied))
        if not is_first:
            return copied.result() or build()
        trees: list[MeshTree] = []
        try:
            trees = build()
        finally:
            with self._lock:
                del self._waiting[key]  # who asks from now on builds: nothing is kept for it
            for other, its in waiting:
                _copy(trees, other, its)
        return trees


def _copy(trees: Sequence[MeshTree], device: wp.Device, copied: Future[list[MeshTree] | None]) -> None:
    """Give `copied` trees like `trees` on `device`. Those in the host's memory are shared: nobody writes to them, and
    each device uploads them.
    """

    def there(array: wp.array) -> wp.array:
        return copied_to(array, device) if array.device.is_cuda else array

    made = None
    try:
        made = [replace(each, nodes=there(each.nodes), triangles=there(each.triangles), over_time=[]) for each in trees]
    except Exception:
        pass  # the device builds its own, and says itself what it fails at
    finally:
        copied.set_result(made)
