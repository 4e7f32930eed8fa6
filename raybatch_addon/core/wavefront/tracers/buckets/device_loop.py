"""Steps of the scheduler that a CUDA device takes by itself: a captured loop (CUDA graphs with conditional nodes).

The body of the loop holds kernels, memsets and sorts alone. How many rays a step has is known on the device only, so
the body holds every step for several sizes of launches, and the policy says which of them is next.

Warp keeps a list of captures under way for the whole process, without a lock, and what is freed on another thread
meanwhile can get into a capture or break it (NVIDIA/warp issues 1678 and 1714). So loops are captured and released one
at a time, on the thread that makes and ends a render, while its workers do nothing, and never by the garbage collector.
"""

from __future__ import annotations

import gc
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import warp as wp

from ....device.kernel import KERNEL_OPTIONS, block_size_of
from .blocks import Moves
from .policy import Step
from .policy_device import GO, QUEUE, DevicePolicy, PolicyState

# Steps that the device takes before the host looks at it: whether the render is to end, and how many rays wait
LOOP_STEPS = 4096


@wp.kernel(**KERNEL_OPTIONS)
def mask_choice_kernel(moves: Moves, policy: PolicyState):
    """One thread: the queue that was chosen will be taken."""
    moves.mask[policy.choice[QUEUE]] = 1


LOOP_KERNELS = [mask_choice_kernel]
_capturing = threading.Lock()


@contextmanager
def _alone() -> Iterator[None]:
    """Captures and releases of other threads wait, and so does the garbage collector."""
    with _capturing:
        collects = gc.isenabled()
        gc.disable()
        try:
            yield
        finally:
            if collects:
                gc.enable()


class DeviceLoop:
    """Takes steps until the policy wants the host's help. On the CPU too, for tests."""

    def __init__(self, policy: DevicePolicy, moves: Moves, serve: Callable[..., None], kernels: Iterable[wp.Kernel]):
        """`serve(step=, bound=)` launches a step for the queue that is marked, which has at most `bound` rays, with
        `kernels`.
        """
        self._policy, self._moves, self._serve, self._device, self._kernels = (
            policy,
            moves,
            serve,
            policy.device,
            list(kernels),
        )
        self._graph: wp.Graph | None = None

    def prepare(self) -> bool:
        """Capture the loop, once; whether the device can take steps by itself."""
        if self._graph is not None or self._device.is_cpu:
            return True
        if not wp.is_conditional_graph_supported():
            return False
        for kernel in self._kernels:  # which must not happen while capturing
            kernel.module.load(self._device, block_size_of(kernel))
        try:
            with _alone(), wp.ScopedCapture(self._device) as capture:
                self._loop()
        except Exception as error:  # of whatever kind a driver has: the host can lead as well
            warnings.warn(
                f"{self._device.alias} cannot take steps of the scheduler by itself ({error}); the host leads, which "
                "is slower",
                stacklevel=2,
            )
            return False
        self._graph = capture.graph
        return True

    def release(self) -> None:
        """Give the captured loop up, once the device is through with it."""
        if self._graph is not None:
            wp.synchronize_device(self._device)
            with _alone():
                self._graph = None

    def run(self) -> None:
        """Take steps as long as `PolicyState.choice[GO]` says so."""
        if self._graph is not None:
            wp.capture_launch(self._graph)
        else:
            self._loop()

    def _loop(self) -> None:
        wp.capture_while(self._policy.state.choice[GO : GO + 1], self._step)

    def _step(self) -> None:
        wp.launch(mask_choice_kernel, 1, [self._moves, self._policy.state], device=self._device)
        branches = self._policy.state.branches
        for k, size in enumerate(self._policy.sizes):
            for branch, step in ((2 * k, Step.TOP), (2 * k + 1, Step.TREELET)):
                wp.capture_if(branches[branch : branch + 1], on_true=self._serve, step=step, bound=size)
        self._policy.launch()
