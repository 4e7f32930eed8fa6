"""One process of Blender: opens a file, renders it with one engine step by step, and writes down each step as it ends.

What ends the process, or the one who waits for it, costs the step alone: those before it are in `steps.json`, with
their pictures beside it.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from lib.output import json_text

from raybatch_addon.core.files import whole_file

STATE = "steps.json"
PICTURES, SOURCES = "pictures", "sources"  # what a process renders
SMALL = 16  # pixels of the edge of the picture that costs next to nothing but what every render costs
SEEDS = (1, 2)


class Steps:
    """The steps of this process, on disk."""

    def __init__(self, folder: Path):
        self._folder = folder
        self.state: dict[str, Any] = {"doing": "starting Blender", "steps": [], "error": ""}
        self.write()

    def write(self) -> None:
        """Put everything on disk, whole."""
        with whole_file(self._folder / STATE) as temporary:
            temporary.write_text(json_text(self.state), encoding="utf-8")

    def run(self, name: str, work: Callable[[], Any]) -> Any:
        """What `work` returns; its seconds are those of the step `name`."""
        self.state["doing"] = name
        self.write()
        start = time.perf_counter()
        result = work()
        self.state["steps"].append({"name": name, "seconds": round(time.perf_counter() - start, 4)})
        self.write()
        return result

    def picture(self, name: str, work: Callable[[], np.ndarray], report: Callable[[], dict]) -> None:
        """Run `work`, and keep its picture under `name`, with what `report` returns."""
        pixels = self.run(name, work)
        with whole_file(self._folder / f"{name}.npy") as temporary, open(temporary, "wb") as file:
            np.save(file, pixels)
        self.state["steps"][-1] |= report()
        self.write()

    def fail(self, text: str) -> None:
        """End with an error."""
        self.state["error"] = text
        self.write()


def end_with_the_caller() -> None:
    """End this process, and those that it started, when the one that waits for it is gone: its pipe is closed then."""

    def watch() -> None:
        sys.stdin.buffer.read()
        if os.getpgrp() == os.getpid():  # as `process.py` starts it: a group of its own
            os.killpg(os.getpgrp(), signal.SIGKILL)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def work(request_file: Path) -> int:
    """Do what the request in `request_file` says, in its folder; the exit code."""
    end_with_the_caller()
    request = json.loads(request_file.read_text(encoding="utf-8"))
    folder = request_file.parent
    steps = Steps(folder)
    try:
        import bpy  # noqa: F401
    except ImportError as error:
        steps.fail(
            f"there is no bpy in this Python: use the project's environment, which `make environment` makes ({error})"
        )
        return 1
    import raybatch_addon
    from raybatch_addon.core.errors import RayBatchError
    from raybatch_addon.core.measure.statistics import versions

    raybatch_addon.register()
    known = versions()
    steps.state["versions"] = {"Blender": known["blender"], "Warp": known["warp"], "RayBatch": known["raybatch"]}
    try:
        (_pictures if request["kind"] == PICTURES else _sources)(steps, request)
    except RayBatchError as error:
        steps.fail(str(error))
        return 1
    steps.state["doing"] = ""
    steps.write()
    return 0


def _opened(steps: Steps, request: dict):
    from real_files.opened import OpenFile

    return steps.run(
        "open",
        lambda: OpenFile(
            request["file"],
            request["engine"],
            request["width"],
            request["threads"],
            request["defaults"],
            request.get("kernels", "AUTO"),
        ),
    )


def picture_steps(samples: int, repeats: int) -> Iterator[tuple[str, int, int, bool]]:
    """Name, samples and seed of each picture of a file, and whether it is a small one; in this order."""
    yield "first", 1, SEEDS[0], False
    yield "again", 1, SEEDS[1], False
    yield "small-first", 1, SEEDS[0], True
    yield "small", 1, SEEDS[1], True
    for pair in seed_pairs(repeats):
        for seed in pair:
            yield f"all-{seed}", samples, seed, False


def seed_pairs(repeats: int) -> list[tuple[int, int]]:
    """The seeds of two pictures for each repeat; the first are `SEEDS`."""
    return [(2 * repeat + SEEDS[0], 2 * repeat + SEEDS[1]) for repeat in range(repeats)]


def _pictures(steps: Steps, request: dict) -> None:
    opened = _opened(steps, request)
    steps.state |= {"size": list(opened.size), "missing": opened.missing(), "scene": opened.scene.name}
    steps.state |= opened.prepared()
    for name, samples, seed, small in picture_steps(request["samples"], request["repeats"]):
        size = (SMALL, SMALL) if small else None
        steps.picture(name, lambda: opened.render(samples, seed, size), opened.record)


def _sources(steps: Steps, request: dict) -> None:
    from real_files.sources import leave_alone, sources_of

    names = [each.name for each in sources_of(_opened(steps, request).scene)]
    steps.state["sources"] = names
    for number, name in enumerate(names):
        opened = _opened(steps, request)  # anew: what was turned off stays so
        leave_alone(opened.scene, name)
        for seed in SEEDS:
            # seeds of their own: pictures of two sources with one seed share their noise, which would not average out
            picture = 10 * (number + 1) + seed
            steps.picture(f"source-{number}-{seed}", lambda: opened.render(request["samples"], picture), opened.record)
