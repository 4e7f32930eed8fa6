"""Which schedule is the fastest for a scene: each candidate renders it for seconds, and the films are compared.

Candidates are tried one setting after another, each beside the best so far; what is faster by a margin is kept. All
render the same samples, so that their films are equal bit for bit on one device.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from .errors import RayBatchError
from .film import Film
from .observers import Progress
from .settings.settings import SETTINGS, RenderSettings

# What a candidate must save to be taken [share of the time]: less is noise of the clock
_LEAST_GAIN = 0.03
# A candidate that takes so many times as long as the best is given up, after a moment [s]
_GIVEN_UP, _MOMENT = 2.0, 0.5
# Settings that are tried, with their values; `ray_count` is tried beside what it is
_VALUES = {"batching": ("OFF", "ON"), "ray_sort": ("OFF", "ON"), "hit_sort": ("OFF", "ON")}
_RAY_COUNT_FACTORS = (0.5, 2.0)

# Renders with settings until the first function says that it is to end, and reports to the second one how far it is
Render = Callable[[RenderSettings, Callable[[], bool], Callable[[Progress], None]], Film]


@dataclass(frozen=True)
class Trial:
    """A candidate, and how it did."""

    changes: dict[str, Any]  # settings that are others than those that were given
    device: str
    seconds: float | None = None  # of a sample of every pixel; None where it was given up
    same_bits: bool | None = None  # whether its film is that of the first one on the device; None: not known
    why: str = ""  # it has no time


@dataclass
class Tuning:
    """The schedules that were tried, the given settings first."""

    settings: RenderSettings
    samples: int = 0  # that each candidate rendered
    tier: str = ""  # of the kernels: GENERAL or SPECIALISED
    trials: list[Trial] = field(default_factory=list)
    ended: bool = False  # everything was tried

    @property
    def best(self) -> Trial | None:
        """The fastest one, or the given settings where no other is faster by a margin; None before the first."""
        timed = [
            (trial, trial.seconds)
            for trial in self.trials
            if trial.seconds is not None and trial.same_bits is not False
        ]
        if not timed:
            return None
        fastest, seconds = min(timed, key=lambda each: each[1])
        given, seconds_given = timed[0]
        return fastest if is_faster(seconds, seconds_given) else given


def is_faster(seconds: float, than: float) -> bool:
    """Whether `seconds` are less by more than a clock's noise."""
    return seconds < than * (1 - _LEAST_GAIN)


def tune(
    settings: RenderSettings,
    devices: Sequence[str],
    render: Render,
    seconds: float,
    *,
    cancelled: Callable[[], bool] = lambda: False,
    on_trial: Callable[[Tuning, str], None] = lambda _tuning, _next: None,
) -> tuple[Tuning, Film | None]:
    """Try candidates on `devices`, each for about `seconds`; returns what came of it and the film of the given
    settings.

    `on_trial` hears before each trial which one it is. What is slow is given up. An error of the given settings is
    raised, that of a candidate stands in its trial.
    """
    return _Tuner(settings, devices, render, seconds, cancelled, on_trial).run()


class _Tuner:
    def __init__(
        self,
        settings: RenderSettings,
        devices: Sequence[str],
        render: Render,
        seconds: float,
        cancelled: Callable[[], bool],
        on_trial: Callable[[Tuning, str], None],
    ):
        # all that a clock or an estimate ends would give each candidate other samples
        ends = dict(time_limit=0.0, error_target=0.0, error_estimate="OFF", adaptive_sampling="OFF", denoise="OFF")
        self._base = settings.replace(**ends, counters="OFF")
        self._devices, self._render, self._cancelled, self._on_trial = devices, render, cancelled, on_trial
        self._seconds = seconds
        self._digests: dict[str, str] = {}  # by device
        self.tuning = Tuning(settings)

    def run(self) -> tuple[Tuning, Film | None]:
        film, samples = self._first()
        if film is None:
            return self.tuning, None
        # all render with the kernels that were chosen for the first
        self.tuning.samples, self.tuning.tier = samples, film.statistics["kernels"]["tier"]
        self._base = self._base.replace(sample_count=samples, kernel_tier=self.tuning.tier)
        if samples > 1:
            film = self._trial({}, raises=True) or film
        else:
            self._note({}, film)
        for changes in self._candidates(film):
            if self._cancelled():
                return self.tuning, film
            self._trial(changes)
        best = self.tuning.best
        if best is not None and best.changes:  # it is looked at twice, as the machine may have had other work meanwhile
            for trial in (self.tuning.trials[0], best):
                self._again(trial)
        self.tuning.ended = not self._cancelled()
        return self.tuning, film

    def _again(self, trial: Trial) -> None:
        """Try the settings of `trial`, which ended, once more; its time is the shorter one."""
        assert trial.seconds is not None
        count = len(self.tuning.trials)
        self._trial(trial.changes)
        second = self.tuning.trials[-1].seconds if len(self.tuning.trials) > count else None
        del self.tuning.trials[count:]
        if second is not None and second < trial.seconds:
            place = next(i for i, each in enumerate(self.tuning.trials) if each is trial)
            self.tuning.trials[place] = replace(trial, seconds=second)

    def _first(self) -> tuple[Film | None, int]:
        """A film of one sample, and how many samples take the time that a trial has."""
        self._on_trial(self.tuning, "")
        film = self._render(self._base.replace(sample_count=1), self._cancelled, lambda _progress: None)
        if not film.complete:
            return None, 0
        wanted = int(self._seconds / max(film.statistics["seconds"]["render"], 1e-6))
        return film, max(1, min(wanted, self.tuning.settings.sample_count))

    def _candidates(self, film: Film) -> Iterator[dict[str, Any]]:
        """Changes to the given settings, each on top of the best so far."""
        for device in self._devices:
            yield {"device": device}
        for name, values in _VALUES.items():
            best = self._best_changes()
            now = best.get(name, getattr(self._base, name))
            chosen = film.statistics.get("auto", {}).get(name, {}).get("value") if now == "AUTO" else now
            for value in values:
                if value != chosen:
                    yield {**best, name: value}
        best, found = self._best_changes(), film.statistics
        alive = found["schedule"]["ray_count"] / len(found["devices"])  # the setting is of each device
        for factor in _RAY_COUNT_FACTORS:
            yield {**best, "ray_count": max(1, round(alive * factor))}

    def _best_changes(self) -> dict[str, Any]:
        best = self.tuning.best
        return best.changes if best else {}

    def _trial(self, changes: dict[str, Any], raises: bool = False) -> Film | None:
        self._on_trial(self.tuning, ", ".join(_in_words(name, value) for name, value in changes.items()))
        best = self.tuning.best
        limit = float("inf")
        if best is not None and best.seconds is not None:
            limit = _GIVEN_UP * best.seconds * self.tuning.samples + _MOMENT
        clock = _Clock(limit)
        try:
            # another device renders with what it has: its kernels are not compiled to be tried
            tier = {"kernel_tier": "AUTO"} if "device" in changes else {}
            settings = self._base.replace(**tier, **changes)
            film = self._render(settings, lambda: self._cancelled() or clock.is_over(), clock.look)
        except RayBatchError as error:
            if raises:
                raise
            self.tuning.trials.append(Trial(changes, changes.get("device", ""), why=str(error)))
            return None
        self._note(changes, film)
        return film

    def _note(self, changes: dict[str, Any], film: Film) -> None:
        device = film.statistics["device"]["alias"]
        if not film.complete:
            if not self._cancelled():
                self.tuning.trials.append(Trial(changes, device, why="slower"))
            return
        digest = _digest(film)
        same = self._digests.setdefault(device, digest) == digest
        seconds = film.statistics["seconds"]["render"] / self._base.sample_count
        self.tuning.trials.append(Trial(changes, device, seconds, same))


class _Clock:
    """Decides when a trial's time is over, counted from where it traces rays: not while kernels are compiled."""

    def __init__(self, limit: float):
        self._limit = limit
        self._start: float | None = None

    def look(self, progress: Progress) -> None:
        if self._start is None and progress.stage == "render":
            self._start = time.perf_counter()

    def is_over(self) -> bool:
        return self._start is not None and time.perf_counter() - self._start > self._limit


def _digest(film: Film) -> str:
    """A digest of every bit of the film's passes."""
    digest = hashlib.sha256()
    for name, pixels in sorted(film.passes.items()):
        digest.update(name.encode())
        digest.update(pixels.tobytes())
    return digest.hexdigest()


def _in_words(name: str, value: Any) -> str:
    """A setting and its value as panels show them."""
    info = SETTINGS[name]
    return f"{info.label} {next((label for identifier, label, _ in info.choices if identifier == value), value)}"
