"""What the threads of other GPUs cost a render on one, for machines that have fewer GPUs than are to be known about.

Workers of several GPUs are threads of one process: they share Python's lock, and processors. Beside a render run the
threads of so many other GPUs. They are the renderer's own workers, with all that these do on the host, from turn to
turn; only launches and copies are left out, and lengths of lists are made up. A GPU of theirs is a clock: it takes as
long for a turn as the real one takes alone, and one turn after another. What is not in it: locks of the driver, and
memory and buses that real GPUs share.
"""

from __future__ import annotations

import ctypes
import statistics
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from unittest import mock

import warp as wp
from rendering.standalone import resized

from raybatch_addon.core.device.launches import LaunchTurns
from raybatch_addon.core.scene.archive import load_scene
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.integrator import TileIntegrator
from raybatch_addon.core.wavefront.path_lists import Counts, Length
from raybatch_addon.core.wavefront.render import workers
from raybatch_addon.core.wavefront.scheduler import CUDA_RAYS, Rectangle, WaterMarks
from raybatch_addon.core.wavefront.tile_state import TileState
from studies import scenes
from studies.study import Case, Options, Row

if TYPE_CHECKING:
    from studies.bench import Bench

SCENES = ("room", "demo")
OTHERS = (0, 1, 3, 7)
# How workers were when several GPUs were measured, and how they are where that is left open
SCHEMES: dict[str, dict[str, Any]] = {"one worker": {"ray_count": CUDA_RAYS}, "two workers": {}}
FRAMES = ((96, 54, 8), (3840, 2160, 96))  # width, height, samples: quick and full
BOUNCES = 7
SMALL = 4  # samples of a render that loads kernels

PATHS = 4096  # of a worker of another GPU: what its memory is
TILE = Rectangle(0, 0, 64, 64)
SAMPLES = 1 << 17  # of it: more than anybody waits for
DONE_SHARE = 0.2  # of the paths alive, that come to their end in a turn

_its = threading.local()  # of a thread of another GPU: its `OtherWorker`


@dataclass
class OtherGpu:
    """A GPU that takes `turn_seconds` for a turn, and one turn after another."""

    turn_seconds: float
    turns: LaunchTurns = field(default_factory=LaunchTurns)
    free_at: float = 0.0
    busy: float = 0.0  # [s]

    def take(self) -> float:
        """It is given a turn; when it will be through with it."""
        self.free_at = max(self.free_at, time.perf_counter()) + self.turn_seconds
        self.busy += self.turn_seconds
        return self.free_at


@dataclass
class OtherWorker:
    """A worker of another GPU: its times on the host."""

    gpu: OtherGpu
    done_at: float = 0.0
    woke: float = 0.0
    integrator: TileIntegrator | None = None
    seconds: list[float] = field(default_factory=list)  # of its turns on the host

    def lengths(self) -> list[int]:
        """Of its lists, made up: some paths come to their end, the others scatter, half of them with a shadow ray."""
        assert self.integrator is not None
        alive, found = self.integrator._alive, [0] * len(Length)
        found[Length.DONE] = round(DONE_SHARE * alive)
        found[Length.BOUNCE] = found[Length.BOUNCE_LATER] = alive - found[Length.DONE]
        found[Length.SHADOW] = alive // 2
        return found


@contextmanager
def without_a_device() -> Iterator[None]:
    """What threads of other GPUs launch and copy is left out; for other threads all is as it is."""
    launch, scan, send, arrived = wp.Launch.launch, wp.utils.array_scan, Counts.send, Counts.arrived
    nothing = ctypes.CDLL(None).getpid  # gives Python's lock up, as a launch does

    def launched(self: wp.Launch, stream: wp.Stream | None = None) -> None:
        launch(self, stream) if not hasattr(_its, "worker") else nothing()

    def scanned(*inputs: Any, **options: Any) -> None:
        scan(*inputs, **options) if not hasattr(_its, "worker") else nothing()

    def sent(self: Counts) -> None:
        if (worker := getattr(_its, "worker", None)) is None:
            return send(self)
        worker.done_at = worker.gpu.take()
        worker.seconds.append(time.perf_counter() - worker.woke)
        return None

    def came(self: Counts) -> list[int]:
        if (worker := getattr(_its, "worker", None)) is None:
            return arrived(self)
        time.sleep(max(worker.done_at - time.perf_counter(), 0.0))
        worker.woke = time.perf_counter()
        return worker.lengths()

    with (
        mock.patch.object(wp.Launch, "launch", launched),
        mock.patch.object(wp.utils, "array_scan", scanned),
        mock.patch.object(Counts, "send", sent),
        mock.patch.object(Counts, "arrived", came),
    ):
        yield


class Others:
    """The threads of other GPUs, while this context is open."""

    def __init__(self, count: int, turn_seconds: float, made: tuple[Any, ...]):
        """`made`: what the real workers were made of, and how many of them a GPU has."""
        self._made, per_gpu = made[:-1], made[-1]
        self._gpus = [OtherGpu(turn_seconds) for _ in range(count)]
        self._workers = [OtherWorker(gpu) for gpu in self._gpus for _ in range(per_gpu)]
        self._end = threading.Event()
        self._threads = [threading.Thread(target=self._work, args=(each,), daemon=True) for each in self._workers]
        self._errors: list[BaseException] = []
        self._begun = 0.0

    def __enter__(self) -> Others:
        self._begun = time.perf_counter()
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._seconds = time.perf_counter() - self._begun
        self._end.set()
        for thread in self._threads:
            thread.join()
        if self._errors:
            raise self._errors[0]

    def _work(self, worker: OtherWorker) -> None:
        _its.worker = worker
        scene, frame, settings = self._made
        marks = WaterMarks(PATHS, round(settings.ray_low_water * PATHS), PATHS)
        try:
            worker.integrator = TileIntegrator(scene, frame, settings, marks, 0, worker.gpu.turns)
            worker.integrator.patience, worker.woke = 0.0, time.perf_counter()
            worker.integrator.render(TileState(TILE), 0, SAMPLES, self._end.is_set)
        except BaseException as error:  # raised where the context ends
            self._errors.append(error)

    def report(self) -> dict[str, float]:
        """What a turn took a worker on the host [ms], and the share of the time that the GPUs were busy."""
        turns = [each for worker in self._workers for each in worker.seconds]
        if not turns:
            return {}
        busy = sum(each.busy for each in self._gpus) / (len(self._gpus) * self._seconds)
        return {"host_ms": round(1e3 * statistics.median(turns), 3), "busy": round(min(busy, 1.0), 4)}


def cases(options: Options) -> list[Case]:
    """Numbers of other GPUs take turns within each scene and scheme."""
    return [
        Case(
            f"{scene}, {scheme}, {others} others", f"{scene}, {scheme}", dict(scene=scene, scheme=scheme, others=others)
        )
        for scene in SCENES
        for scheme in SCHEMES
        for others in OTHERS
    ]


_turn_seconds: dict[str, float] = {}  # of a GPU alone, by group


def measured_beside(case: Case, bench: Bench) -> Row:
    """One render beside the threads of other GPUs."""
    what, options = case.what, bench.options
    width, height, samples = options.pick(*FRAMES)
    scene = bench.scene(what["scene"], lambda: _made(what["scene"], options, width, height))
    settings = RenderSettings(sample_count=samples, bounce_max=BOUNCES, kernel_tier="SPECIALISED")
    settings = settings.replace(**SCHEMES[what["scheme"]])
    made = _workers_of(bench, scene, settings.replace(sample_count=SMALL))
    if what["others"] == 0 or case.group not in _turn_seconds:
        seconds, turns = _rendered(bench, scene, settings)
        _turn_seconds[case.group] = seconds / turns
        if what["others"] == 0:
            return {"seconds": seconds, "turns": turns, "workers": made[-1]}
    with without_a_device(), Others(what["others"], _turn_seconds[case.group], made) as others:
        seconds, turns = _rendered(bench, scene, settings)
    return {"seconds": seconds, "turns": turns, "workers": made[-1]} | others.report()


def _made(name: str, options: Options, width: int, height: int) -> Scene:
    if name == "room":
        return scenes.room(width, height)
    return resized(load_scene(scenes.find(name, options))[0], width, height)


def _workers_of(bench: Bench, scene: Scene, settings: RenderSettings) -> tuple[Any, ...]:
    """What workers of a render are made of, and how many there are."""
    made: list[tuple[Any, ...]] = []
    worker = workers.worker_class(settings)

    def noted(*inputs: Any) -> TileIntegrator:
        made.append(inputs[:3])
        return worker(*inputs)

    with mock.patch.object(workers, "worker_class", lambda _: noted):
        bench.session.render(scene, settings)
    return (*made[0], len(made))


def _rendered(bench: Bench, scene: Scene, settings: RenderSettings) -> tuple[float, int]:
    """Seconds of rendering, and turns of its workers."""
    turns, arrived = [0], Counts.arrived

    def counted(self: Counts) -> list[int]:
        turns[0] += not hasattr(_its, "worker")
        return arrived(self)

    with mock.patch.object(Counts, "arrived", counted):
        return bench.session.render(scene, settings).statistics["seconds"]["render"], turns[0]
