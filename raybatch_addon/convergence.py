"""Records of renders: error and rays a second over time, of the last ones to compare. Without Blender, and safe to read while one runs.

A render writes from its own thread, through an observer of `Session.render`; whoever shows it reads `Run`s, which never change.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import queue
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .core.report.convergence import ErrorPoint, Slope, fit_slope, geometric_samples, slope_data, time_to
from .core.report.half_error import half_error
from .core.settings import SETTINGS
from .plotting.axes import number_text, seconds_text

if TYPE_CHECKING:
    from .core.report.snapshot import Snapshot
    from .core.session import Progress

# Runs that are there to compare
SLOT_COUNT = 6
# Samples of a snapshot to those of the one before: at first, and from where a round takes longer than what it costs to make it one
FIRST_RATIO, SNAPSHOT_RATIO, FIRST_SAMPLES = 2.0, 1.5, 16
# Share by which the time grows from one point of rays a second to the next, and the least time between two [s]
RATE_GROWTH, RATE_SECONDS = 0.1, 0.2
# Snapshots that wait until their errors are computed; beyond it the oldest is left out
WAITING_SNAPSHOTS = 3
# Settings that say when a render ends and what is told of it, and words for what ended one
_END_SETTINGS = {"sample_count", "time_limit", "error_estimate", "error_target"}
_ENDINGS = {"error": "stopped at its error", "time": "stopped by its time limit"}
RUNNING, FINISHED, CANCELLED, FAILED = "running", "finished", "cancelled", "failed"


@dataclass(frozen=True)
class RatePoint:
    """Rays a second since the point before."""

    seconds: float  # of rendering
    rays_per_second: float


@dataclass(frozen=True)
class Run:
    """What is known of one render of one view layer; a copy that stays as it is."""

    number: int  # counts all runs
    slot: int  # 0 to SLOT_COUNT - 1
    scene: str
    layer: str
    frame: int
    settings: dict[str, Any]  # all of `RenderSettings`
    state: str = RUNNING
    points: tuple[ErrorPoint, ...] = ()  # ascending; empty where the error is not estimated
    rates: tuple[RatePoint, ...] = ()  # ascending
    seconds: float = 0.0  # of rendering, as far as it came
    samples: float = 0.0  # of every pixel, in the mean
    device: str = ""
    stopped_by: str | None = None  # "samples", "error" or "time"
    error: dict[str, Any] | None = None  # as in the statistics of the film
    problem: str = ""  # why there are no more points
    kept: bool = False  # newer runs leave it alone
    shown: bool = True  # in the plot

    @property
    def estimates_error(self) -> bool:
        """Whether it was asked for."""
        return self.settings["error_estimate"] == "ON" or self.settings["error_target"] > 0

    @property
    def slope(self) -> Slope | None:
        """Of its error against samples; None below two points."""
        return fit_slope(self.points)

    def time_to(self, target: float) -> tuple[float, bool] | None:
        """Seconds of rendering to a relMSE of `target`, and whether they are extrapolated; None: not known, or never."""
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

    def begin(self, scene: str, layer: str, frame: int, settings: Any) -> Run:
        """A new run, in a free slot, else in that of the oldest run that is not kept."""
        with self._lock:
            free = [i for i, run in enumerate(self._slots) if run is None]
            loose = sorted((run.number, run.slot) for run in self._slots if run and not run.kept)
            slot = free[0] if free else loose[0][1]
            run = Run(next(self._numbers), slot, scene, layer, frame, dataclasses.asdict(settings))
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


class RateRecorder:
    """An observer of `Session.render` that costs next to nothing: rays a second, from what the session tells anyway."""

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
            seconds = statistics["seconds"]["render"]
            if seconds > self._seconds:
                self._add(seconds, float(statistics["rays"]["total"]))
            changes.update(
                rates=tuple(self._rates), seconds=seconds, samples=float(statistics["samples_per_pixel"]), device=statistics["device"]["alias"],
                stopped_by=statistics["stopped_by"], error=statistics["error"],
            )  # fmt: skip
        self._store.change(self._number, **changes)

    def _add(self, seconds: float, rays: float) -> None:
        whole = round(rays)
        if whole > self._rays:  # they are counted when they come back, many together: until then there is nothing to say
            self._rates.append(RatePoint(seconds, (whole - self._rays) / (seconds - self._seconds)))
            self._seconds, self._rays = seconds, whole


class ErrorRecorder(RateRecorder):
    """Beside rays a second the error, for a render with `error_estimate` ON.

    Pictures are handed to a thread of its own: computing errors does not hold up the render.
    """

    def __init__(self, runs: RunStore, run: Run) -> None:
        super().__init__(runs, run)
        self._points: list[ErrorPoint] = []
        self._waiting: queue.Queue[Snapshot | None] = queue.Queue()
        self._thread = threading.Thread(target=self._compute, name="RayBatch convergence", daemon=True)
        self._thread.start()

    def snapshot_samples(self, sample_count: int) -> Sequence[int]:
        """From the least on that the error can be told of."""
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
            self._store.change(self._number, problem=f"the error could not be computed: {type(error).__name__}: {error}")
            while self._waiting.get() is not None:
                pass


def point_of_halves(snapshot: Snapshot) -> ErrorPoint | None:
    """The error at `snapshot`, as the film's statistics tell it; None where one of the halves has no sample."""
    if snapshot.halves is None or snapshot.samples < 2:
        return None
    error = half_error(*snapshot.halves, snapshot.samples)
    return ErrorPoint(
        snapshot.seconds, snapshot.seconds_total, snapshot.samples, dict(snapshot.rays), error.rmse, error.relmse,
        invalid_samples=snapshot.invalid_samples, floor_rmse=0.0, floor_relmse=0.0, from_halves=True,
    )  # fmt: skip


def recorder_for(runs: RunStore, scene: str, layer: str, frame: int, settings: Any) -> RateRecorder:
    """Begin a run, and what is to observe it."""
    run = runs.begin(scene, layer, frame, settings)
    return (ErrorRecorder if run.estimates_error else RateRecorder)(runs, run)


# --- in words


def names_of(runs: Sequence[Run]) -> dict[int, str]:
    """By number, what tells each of `runs` from the others: scene, view layer, frame and settings in which they differ.

    What more than half of them have is not said, and when they end only where they differ in nothing else.
    """
    about = {run.number: {"scene": run.scene, "layer": run.layer, "frame": f"frame {run.frame}"} | _setting_texts(run) for run in runs}
    values = {key: Counter(each.get(key) for each in about.values()) for key in next(iter(about.values()), {})}
    differing = [key for key, counts in values.items() if len(counts) > 1]
    differing = [key for key in differing if key not in _END_SETTINGS] or differing
    names = {}
    for number, each in about.items():
        own = [each[key] for key in differing if key in each and 2 * values[key][each[key]] <= len(about)]
        names[number] = ", ".join([f"#{number}", *own])
    return names


def _setting_texts(run: Run) -> dict[str, str]:
    return {name: f"{SETTINGS[name].label if name in SETTINGS else name} {_value_text(value)}" for name, value in run.settings.items()}


def _value_text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return value.capitalize() if isinstance(value, str) and value.isupper() else str(value)


def error_line(statistics: dict[str, Any]) -> str:
    """How far a render came, and why it ended: samples, error, `stopped_by`. For its statistics."""
    samples = statistics.get("samples_per_pixel")
    if samples is None:
        return ""
    parts = [f"{samples:,} sample{'' if samples == 1 else 's'} per pixel"]
    error = statistics.get("error")
    if error and error.get("relmse") is not None:
        parts.append(f"error {error['relmse']:.3g} (relMSE)" + (f" at {error['samples']:,}" if error["samples"] != samples else ""))
    if statistics.get("stopped_by") in _ENDINGS:
        parts.append(_ENDINGS[statistics["stopped_by"]])
    elif error and error.get("target") and not error.get("reached") and statistics.get("stopped_by"):
        parts.append(f"the error of {error['target']:g} was not reached")
    elif not statistics.get("stopped_by"):
        parts.append("cancelled")
    return ", ".join(parts)


def run_lines(run: Run, target: float) -> list[str]:
    """Where a run stands, its slope, and when it reaches the relMSE `target`."""
    state = _ENDINGS.get(run.stopped_by or "", run.state) if run.state == FINISHED else run.state
    samples = run.samples or (run.points[-1].samples if run.points else 0)
    count = f"{samples:,.0f} samples in " if samples else ""
    head = [f"{state.capitalize()}: {count}{seconds_text(run.seconds)}" if run.seconds else state.capitalize()]
    if run.rates:
        head.append(f"{number_text(run.rates[-1].rays_per_second)} rays/s")
    lines = [", ".join(head)]
    if run.problem:
        lines.append(run.problem)
    if not run.estimates_error:
        return [*lines, "The error is not known: turn on Error Estimate in Sampling"]
    if not run.points:
        return [*lines, "No error yet: it takes two samples"]
    lines.append(f"Error {run.points[-1].relmse:.3g} (relMSE) at {run.points[-1].samples:,} samples")
    slope = run.slope
    if slope is not None:
        lines.append(f"RMSE against samples: {slope.says}")
    lines.append(target_line(run, target))
    return lines


def target_line(run: Run, target: float) -> str:
    """When `run` reaches the relMSE `target`."""
    found = run.time_to(target)
    if found is None:
        return f"relMSE {target:g}: never at this rate"
    seconds, extrapolated = found
    if not extrapolated:
        return f"relMSE {target:g} in {seconds_text(seconds)}"
    left = f", {seconds_text(max(seconds - run.seconds, 0))} left" if run.state == RUNNING else ""
    return f"relMSE {target:g} in about {seconds_text(seconds)}{left} (extrapolated)"


# --- as data


def runs_as_data(runs: Sequence[Run], target: float) -> dict[str, Any]:
    """For JSON, newest run first: keys as those of `scripts/convergence.py --json`, and rays a second."""
    names = names_of(runs)
    newest = runs[0] if runs else None
    return {
        "scene": newest.scene if newest else None,
        "device": newest.device if newest else None,
        "reference": {"kind": "halves", "name": "two halves of each render"},
        "target": {"relmse": target},
        "runs": [_run_as_data(run, names[run.number]) for run in runs],
        "summary": [_summary_as_data(run, names[run.number], target) for run in runs],
        "written": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }


def _run_as_data(run: Run, label: str) -> dict[str, Any]:
    slope = slope_data(run.slope)
    return {
        "settings": run.settings, "seed": run.settings["seed"], "points": [point.data() for point in run.points],
        "slope": slope["slope"], "slope_spread": slope["slope_spread"],
        "run": run.number, "label": label, "scene": run.scene, "layer": run.layer, "frame": run.frame, "device": run.device, "state": run.state,
        "stopped_by": run.stopped_by, "samples": run.samples, "seconds": run.seconds, "error": run.error,
        "rates": [dataclasses.asdict(rate) for rate in run.rates],
    }  # fmt: skip


def _summary_as_data(run: Run, label: str, target: float) -> dict[str, Any]:
    found = run.time_to(target)
    return {
        "label": label, "run": run.number, "runs": 1, **slope_data(run.slope),
        "seconds_to_target": {**dict.fromkeys(("median", "least", "most"), found[0]), "extrapolated": found[1]} if found else None,
    }  # fmt: skip
