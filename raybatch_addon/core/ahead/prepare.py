"""Before the first ray: kernels are compiled or loaded while the scene is built."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future

import warp as wp

from ..device.compiler import CompileStoppedError
from ..device.devices import load_kernels, loaded_modules
from ..device.notes import take_notes
from ..device.ready import write_notes
from ..measure.parts import Parts
from ..wavefront.scene.device_scene import DeviceScene
from ..wavefront.scene.kept_scene import KeptScene
from .aside import WaitedParts, begin_aside, end_of, is_awaited, once_free


class Preparation:
    """Builds a scene and loads kernels, side by side."""

    def __init__(
        self,
        kernels: Sequence[wp.Kernel],
        device: wp.Device,
        before: Future | None,
        closed: Callable[[], bool],
        parts: Parts,
    ):
        """
        Args:
            before: the end of an earlier build that may still run, of a render that was cancelled. It must not touch
                what this one uses.
            closed: whether nobody will want the kernels any more. Those that a cancelled render began to compile are
                finished, for the next one.
            parts: the clock of the render.
        """
        self._kernels, self._device, self._before, self._closed = kernels, device, before, closed
        self._parts, self._waited = parts, WaitedParts(parts)
        self.warnings: list[str] = []
        self.build: Future | None = before  # the end of the last one that was begun, until it is done
        self._loaded, self._total = 0, 1

    def is_given_up(self) -> bool:
        """Whether the build should end."""
        return self._waited.is_given_up()

    def enter(self, part: str) -> None:
        """The next part of the build begins."""
        self._waited.enter(part)

    def run(
        self,
        build: Callable[[], DeviceScene],
        cancelled: Callable[[], bool],
        on_progress: Callable[[str, float, str], None],
        kept: KeptScene,
        asked: tuple,
    ) -> tuple[DeviceScene | None, list[str]]:
        """What `build` returned, or what is `kept` and was `asked` for alike, and the names of the modules; nothing
        when cancelled meanwhile.

        `on_progress` gets a stage, the share of the kernels that are there, and a message.
        """

        def show() -> None:
            waits, message = self._parts.part == "kernels", self._parts.message
            if waits:
                message += f" ({self._loaded} of {self._total})"
            on_progress("compile" if waits else "build", self._loaded / self._total, message)

        if cancelled():
            return None, []
        found, is_free = kept.find(asked), self._before is None or self._before.done()
        if found is not None and is_free and (names := loaded_modules(self._kernels, self._device)) is not None:
            self.build = None
            return found, names  # no thread is begun
        made_by = build if found is None else lambda: found
        modules, built = begin_aside(self._load), begin_aside(functools.partial(self._build, made_by))
        self.build = end_of(built)
        try:
            if not is_awaited(built, cancelled, show):
                return None, []
            made = built.result()  # what it refuses is not waited for until all is compiled
            if not is_awaited(modules, cancelled, show):
                return None, []
            names = modules.result()
            write_notes()  # also of kernels that the build was the first to launch
            self.build = None
            if found is None:
                kept.keep(asked, made)
            self.warnings = take_notes()  # only of a render that goes on: the next one reports what this one cannot
            return made, names
        except CompileStoppedError:  # the session was closed
            return None, []
        finally:
            self._waited.give_up()

    def _load(self) -> list[str]:
        start = time.perf_counter()

        def note(done: int, total: int) -> None:
            self._loaded, self._total = done, max(1, total)

        names = load_kernels(self._kernels, self._device, note, self._closed)
        self._parts.compile_seconds = time.perf_counter() - start
        return names

    def _build(self, build: Callable[[], DeviceScene]) -> DeviceScene:
        built = once_free(self._before, build, self._closed, self._waited)
        wp.synchronize_device(self._device)
        self.enter("kernels")
        return built
