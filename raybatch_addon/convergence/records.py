"""Records of renders: error and rays a second over time, of the last ones to compare. Without Blender, and safe to read
while one runs.

A render writes from its own thread, through an observer of `Session.render`; whoever shows it reads `Run`s, which never
change.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import queue
import threading
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from ..core.convergence.halves import half_error
from ..core.convergence.points import ErrorPoint, Slope, fit_slope, geometric_samples, time_to
from ..core.observers import RenderObserver
from ..core.settings.settings import keeps_halves

if TYPE_CHECKING:
    from ..core.measure.snapshot import Snapshot
    from ..core.observers import Progress
    from ..core.settings.settings import RenderSettings

# Runs that are there to compare
SLOT_COUNT = 6
# Samples of a snapshot to those of the one before: at first, and from where a round takes longer than what it costs to
# make it one
FIRST_RATIO, SNAPSHOT_RATIO, FIRST_SAMPLES = 2.0, 1.5, 16
# Share by which the time grows from one point of rays a second to the next, and the least time between two [s]
RATE_GROWTH, RATE_SECONDS = 0.1, 0.2
# Snapshots that wait until their errors are computed; beyond it the oldest is left out
WAITING_SNAPSHOTS = 3
RUNNING, FINISHED, CANCELLED, FAILED = "running", "finished", "cancelled", "failed"


@dataclass(frozen=True)
class RatePoint:
    """Rays a second since the point before."""

    seconds: float  # of rendering
    rays_per_second: float


@dataclass(frozen=True)
class Run:
    """Record of one render of one view layer, of stereoscopy of one eye; a copy that stays as it is."""

    number: int  # counts all runs
    slot: int  # 0 to SLOT_COUNT - 1
    scene: str
    layer: str
    _: KW_ONLY
    frame: int
    settings: dict[str, Any]  # all of `RenderSettings`
    state: str = RUNNING
    points: tuple[ErrorPoint, ...] = ()  # ascending; empty where the error is not estimated
    rates: tuple[RatePoint, ...] = ()  # ascending
    seconds: float = 0.0  # of rendering, as far as it came
    samples: float = 0.0  # of every pixel, in the mean
    device: str = ""
    stopped_by: str | None = None  # "samples", "error", "noise" or "time"
    error: dict[str, Any] | None = None  # as in the statistics of the film
    problem: str = ""  # why there are no more points
    kept: bool = False  # newer runs leave it alone
    shown: bool = True  # in the plot
    view: str = ""  # of stereoscopy the eye, as the render result calls it

    @property
    def estimates_error(self) -> bool:
        """Whether something asked for it."""
        return keeps_halves(SimpleNamespace(**self.settings))

    @property
    def slope(self) -> Slope | None:
        """Slope of its error against samples; None below two points."""
        return fit_slope(self.points)

    def time_to(self, target: float) -> tuple[float, bool] | None:
        """Seconds of rendering to a relMSE of `target`, and whether they are extrapolated; None: not known, or
        never.
        """
        return time_to(self.points, target) if self.points and target > 0 else None


class RunStore:
    """The last runs, each in a slot. Every method may be called from any thread."""

    def __init__(self, slot_count: int = SLOT_COUNT) -> None:
        self._slots: list[Run | None] = [None] * slot_count
        self._lock = threading.Lock()
        self._numbers = itertools.count(1)
        self.version = 0  # grows with every change

    def runs(self) -> list[Run]:
        """Newest first."""
        with self._lock:
            return sorted((run for run in self._slots if run), key=lambda run: -run.number)

    def last(self) -> Run | None:
        """The newest, running or not."""
        return next(iter(self.runs()), None)

    def begin(self, scene: str, layer: str, frame: int, settings: RenderSettings, view: str = "") -> Run:
        """A new run, in a free slot, else in that of the oldest run that is not kept."""
        with self._lock:
            free = [i for i, run in enumerate(self._slots) if run is None]
            loose = sorted((run.number, run.slot) for run in self._slots if run and not run.kept)
            slot = free[0] if free else loose[0][1]
            run = Run(
                next(self._numbers), slot, scene, layer, frame=frame, settings=dataclasses.asdict(settings), view=view
            )
            self._slots[slot] = run
            self.version += 1
            return run

    def change(self, number: int, **changes: Any) -> bool:
        """Give the run `number` other values; False: it is not there any more."""
        with self._lock:
            for slot, run in enumerate(self._slots):
                if run and run.number == number:
                    self._slots[slot] = dataclasses.replace(run, **changes)
                    self.version += 1
                    return True
            return False

    def keep(self, number: int, kept: bool = True) -> bool:
        """Let newer runs leave run `number` alone, or not; False where no slot would be left for them."""
        others = sum(run.kept for run in self.runs() if run.number != number)
        if kept and others + 1 >= len(self._slots):
            return False
        return self.change(number, kept=kept)

    def clear(self, number: int | None = None) -> None:
        """Forget the run `number`, or all of them; a run that goes on is not seen any more then."""
        with self._lock:
            self._slots = [None if number in (None, run and run.number) else run for run in self._slots]
            self.version += 1


store = RunStore()


class RateRecorder(RenderObserver):
    """An observer of `Session.render` that costs next to nothing: rays a second, from the progress that the session
    reports anyway.
    """

    def __init__(self, runs: RunStore, run: Run) -> None:
        self._store, self._number = runs, run.number
        self._rates: list[RatePoint] = []
        self._seconds, self._rays = 0.0, 0  # at the last point

    def on_progress(self, progress: Progress) -> None:
        """A point, unless there was one just before."""
        seconds = progress.seconds_rendering
        if progress.stage != "render" or seconds < max(self._seconds * (1 + RATE_GROWTH), self._seconds + RATE_SECONDS):
            return
        self._add(seconds, progress.rays_per_second * seconds)
        self._store.change(self._number, rates=tuple(self._rates), seconds=seconds, samples=progress.samples_done)

    def end(self, state: str, statistics: dict[str, Any] | None = None) -> None:
        """The render is over; `statistics` are its film's, where there is one."""
        changes: dict[str, Any] = {"state": state}
        if statistics:
            seconds, adaptive = statistics["seconds"]["render"], statistics.get("adaptive")
            if seconds > self._seconds:
                self._add(seconds, float(statistics["rays"]["total"]))
            changes.update(
                rates=tuple(self._rates),
                seconds=seconds,
                samples=float(adaptive["samples_mean"] if adaptive else statistics["samples_per_pixel"]),
                device=statistics["device"]["alias"],
                stopped_by=statistics["stopped_by"],
                error=statistics["error"],
            )
        self._store.change(self._number, **changes)

    def _add(self, seconds: float, rays: float) -> None:
        whole = round(rays)
        if whole > self._rays:  # rays are counted when they come back, many together: until then nothing is known
            self._rates.append(RatePoint(seconds, (whole - self._rays) / (seconds - self._seconds)))
            self._seconds, self._rays = seconds, whole


class ErrorRecorder(RateRecorder):
    """Beside rays a second the error, for a render whose samples come in two halves.

    Pictures are handed to a thread of its own: computing errors does not hold up the render.
    """

    def __init__(self, runs: RunStore, run: Run) -> None:
        super().__init__(runs, run)
        self._points: list[ErrorPoint] = []
        self._waiting: queue.Queue[Snapshot | None] = queue.Queue()
        self._thread = threading.Thread(target=self._compute, name="RayBatch convergence", daemon=True)
        self._thread.start()

    def snapshot_samples(self, sample_count: int) -> Sequence[int]:
        """Sample counts of the snapshots, from the least on that has an error."""
        counts = geometric_samples(min(sample_count, FIRST_SAMPLES), FIRST_RATIO, first=2)
        if sample_count > FIRST_SAMPLES:
            counts += geometric_samples(sample_count, SNAPSHOT_RATIO, first=round(FIRST_SAMPLES * SNAPSHOT_RATIO))
        if len(counts) > 1 and counts[-1] < counts[-2] * math.sqrt(SNAPSHOT_RATIO):
            del counts[-2]  # a round of its own for so little
        return counts

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """Let its error be computed."""
        while self._waiting.qsize() >= WAITING_SNAPSHOTS:
            try:
                self._waiting.get_nowait()
            except queue.Empty:
                break
        self._waiting.put(snapshot)

    def end(self, state: str, statistics: dict[str, Any] | None = None) -> None:
        """The render is over: all errors are there when this returns."""
        self._waiting.put(None)
        self._thread.join()
        super().end(state, statistics)

    def _compute(self) -> None:
        try:
            while (snapshot := self._waiting.get()) is not None:
                point = point_of_halves(snapshot)
                if point is not None:
                    self._points.append(point)
                    self._store.change(self._number, points=tuple(self._points))
        except Exception as error:  # the render goes on without
            self._store.change(
                self._number, problem=f"the error could not be computed: {type(error).__name__}: {error}"
            )
            while self._waiting.get() is not None:
                pass


def point_of_halves(snapshot: Snapshot) -> ErrorPoint | None:
    """The error at `snapshot`, as in the film's statistics; None where one of the halves has no sample."""
    if snapshot.halves is None or snapshot.samples < 2:
        return None
    error = half_error(*snapshot.halves, snapshot.each)
    return ErrorPoint(
        seconds=snapshot.seconds,
        seconds_total=snapshot.seconds_total,
        samples=snapshot.samples_mean,
        samples_most=snapshot.samples,
        rays=dict(snapshot.rays),
        rmse=error.rmse,
        relmse=error.relmse,
        invalid_samples=snapshot.invalid_samples,
        floor_rmse=0.0,
        floor_relmse=0.0,
        from_halves=True,
    )


def recorder_for(
    runs: RunStore, scene: str, layer: str, frame: int, settings: RenderSettings, view: str = ""
) -> RateRecorder:
    """Begin a run, and what is to observe it."""
    run = runs.begin(scene, layer, frame, settings, view)
    return (ErrorRecorder if run.estimates_error else RateRecorder)(runs, run)
