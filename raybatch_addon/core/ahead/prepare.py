"""Before the first ray: kernels are compiled or loaded while the scene is built."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait

import warp as wp

from ..device.compiler import CompileStoppedError, given_up_when
from ..device.devices import load_kernels
from ..device.notes import take_notes
from ..wavefront.scene.device_scene import DeviceScene

_POLL_SECONDS = 0.02
# Messages by stage of the build (`DeviceScene.build`)
_MESSAGES = {
    "images": "Uploading images",
    "tree": "Building the tree",
    "materials": "Uploading materials",
    "lights": "Measuring lights",
}


class Preparation:
    """Builds a scene and loads kernels, side by side."""

    def __init__(
        self, kernels: Sequence[wp.Kernel], device: wp.Device, before: Future | None, closed: Callable[[], bool]
    ):
        """
        Args:
            before: an earlier build that may still run, of a render that was cancelled. It must not touch what this
                one uses.
            closed: whether nobody will want the kernels any more. Those that a cancelled render began to compile are
                finished, for the next one.
        """
        self._kernels, self._device, self._before, self._closed = kernels, device, before, closed
        self.warnings: list[str] = []
        self.seconds: dict[str, float] = {}  # by stage
        self.build: Future | None = None
        self._loaded, self._total = 0, 1
        self._stage, self._stage_begun = "images", time.perf_counter()
        self._given_up = threading.Event()  # nobody waits for the build any more

    def is_given_up(self) -> bool:
        """Whether the build should end."""
        return self._given_up.is_set()

    def note_stage(self, stage: str) -> None:
        """The next stage of the build begins."""
        now = time.perf_counter()
        self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + now - self._stage_begun
        self._stage, self._stage_begun = stage, now

    def run(
        self,
        build: Callable[[], DeviceScene],
        cancelled: Callable[[], bool],
        on_progress: Callable[[str, float, str], None],
    ) -> tuple[DeviceScene | None, list[str]]:
        """What `build` returned, and the names of the modules; nothing when cancelled meanwhile.

        `on_progress` is told a stage, the share of the kernels that are there, and a message.
        """
        pool = ThreadPoolExecutor(max_workers=2)
        try:
            modules, built = pool.submit(self._load), pool.submit(self._build, build)
            self.build = built
            while not (modules.done() and built.done()):
                if cancelled():
                    return None, []
                compiling = built.done() and not modules.done()
                message = (
                    f"Compiling kernels ({self._loaded} of {self._total})" if compiling else _MESSAGES[self._stage]
                )
                on_progress("compile" if compiling else "build", self._loaded / self._total, message)
                wait([each for each in (modules, built) if not each.done()], _POLL_SECONDS)
            made = built.result(), modules.result()
            self.warnings = take_notes()  # only of a render that goes on: the next one tells what this one cannot
            return made
        except CompileStoppedError:  # the session was closed
            return None, []
        finally:
            self._given_up.set()
            pool.shutdown(wait=False)  # a cancelled render does not wait for the compiler

    def _load(self) -> list[str]:
        start = time.perf_counter()

        def note(done: int, total: int) -> None:
            self._loaded, self._total = done, max(1, total)

        names = load_kernels(self._kernels, self._device, note, self._closed)
        self.seconds["compile"] = time.perf_counter() - start
        return names

    def _build(self, build: Callable[[], DeviceScene]) -> DeviceScene:
        if self._before:
            wait([self._before])
        start = self._stage_begun = time.perf_counter()
        with given_up_when(self._closed):  # it launches kernels that build trees
            built = build()
        wp.synchronize_device(self._device)
        self.note_stage(self._stage)
        self.seconds["build"] = time.perf_counter() - start
        return built
