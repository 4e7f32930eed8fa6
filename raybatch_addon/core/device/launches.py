"""Launches of kernels that are made again and again: most of their arguments stay; and whose turn it is to launch."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import warp as wp

from .kernel import block_size_of


class RepeatedLaunches:
    """Launches kernels on one device, for one thread.

    Warp packs every argument anew at each launch, which takes a host 20 to 30 microseconds for a kernel of the
    integrator: more than the kernel itself takes a CPU when few paths are left, and enough to let a GPU wait. Each
    kernel's last launch is kept here, and only arguments that are other objects than then are packed: on the CPU turns
    of few paths take a third of the time, on a GPU whole renders 1 to 6 % less. A struct that was changed in place is
    launched as it is; what was launched last is kept alive.
    """

    def __init__(self, device: wp.Device, block_size: int = 0):
        """`block_size`: threads of a block, in all launches (0: as each kernel asks for)."""
        self._device, self._block_size = device, block_size
        self._kept: dict[wp.Kernel, _Kept] = {}

    def launch(self, kernel: wp.Kernel, count: int, *inputs: Any) -> None:
        """Launch `count` threads, as `wp.launch` does."""
        if count == 0:
            return
        kept = self._kept.get(kernel)
        if kept is None:
            block_dim = (self._block_size or block_size_of(kernel)) if self._device.is_cuda else 1
            command = wp.launch(kernel, count, list(inputs), device=self._device, record_cmd=True, block_dim=block_dim)
            self._kept[kernel] = kept = _Kept(command, count, list(inputs))
        else:
            kept.change(count, inputs)
        kept.command.launch()


class NoTurns:
    """Whoever wants to launches: there is one worker, or they share nothing."""

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass

    @contextlib.contextmanager
    def left(self) -> Iterator[None]:
        """As it is."""
        yield


class LaunchTurns(NoTurns):
    """Workers of one CUDA device, each on its own thread, launch in turns: `with turns: ...`.

    All launches of a device go to one stream. What a worker launches in its turn lies there side by side: times between
    its events are its own, but for copies and pictures of other threads, and memory that the device has once for all,
    as for sorting, is used by one at a time. While it waits for the device, as in `with turns.left(): ...`, another one
    launches: the device has work meanwhile, whatever the host does.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    @contextlib.contextmanager
    def left(self) -> Iterator[None]:
        """It is the turn of others meanwhile."""
        self._lock.release()
        try:
            yield
        finally:
            self._lock.acquire()


class _Kept:
    """A launch, and what it was packed from."""

    def __init__(self, command: wp.Launch, count: int, inputs: list[Any]):
        self.command, self._count, self._inputs = command, count, inputs

    def change(self, count: int, inputs: tuple[Any, ...]) -> None:
        """Set what the next launch gets."""
        if count != self._count:
            self.command.set_dim(count)
            self._count = count
        before = self._inputs
        for place, value in enumerate(inputs):
            if value is not before[place]:
                self.command.set_param_at_index(place, value)
                before[place] = value
