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
from ...device.failures import lacks_memory
from ...native.structs import copied_to
from .mesh_tree import MeshTree


class TreesInCommon:
    """The mesh trees of one scene for `devices` of a render, each of which asks on a thread of its own."""

    def __init__(self, devices: Sequence[wp.Device]):
        self._devices, self._lock = devices, threading.Lock()
        self._made: dict[Hashable, Future[dict[str, list[MeshTree]]]] = {}  # copies by device, by what was asked for

    def get(self, device: wp.Device, kind: Hashable, build: Callable[[], list[MeshTree]]) -> list[MeshTree]:
        """Trees on `device`: what `build` makes, or what it made on another one of the same model that asked for this
        `kind`. They are the caller's. Raises what `build` raises; where another device's fails, it is tried here.
        """
        key = kind, next(i for i, each in enumerate(self._devices) if is_alike(each, device))
        with self._lock:
            made = self._made.get(key)
            if is_first := made is None:
                made = self._made[key] = Future()
        if not is_first:
            return made.result().pop(device.alias, None) or build()
        copies: dict[str, list[MeshTree]] = {}
        try:
            trees = build()
            for other in self._devices:
                if other != device and is_alike(other, device):
                    _copy(trees, other, copies)
        finally:
            made.set_result(copies)
        return trees


def _copy(trees: Sequence[MeshTree], device: wp.Device, copies: dict[str, list[MeshTree]]) -> None:
    """Add copies on `device` to `copies`, if it has room for them. Trees in the host's memory are not copied: they are
    uploaded from there.
    """

    def there(array: wp.array) -> wp.array:
        return copied_to(array, device) if array.device.is_cuda else array

    try:
        copies[device.alias] = [
            replace(each, nodes=there(each.nodes), triangles=there(each.triangles), over_time=[]) for each in trees
        ]
    except (MemoryError, RuntimeError) as error:
        if not lacks_memory(error):
            raise
