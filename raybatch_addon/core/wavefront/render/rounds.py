"""Rounds: consecutive ranges of samples of every pixel, and when a render ends. Pure policy, without Warp or a device.

After a round every pixel that gets samples has the same number of them, so the picture is an estimate as good as any;
in the middle of a round it is not, for short paths come home first. A render is one round unless somebody wants more:
an observer snapshots, a time limit, an error target, or adaptive sampling looks at its noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

from ...settings.settings import RenderSettings
from ..adaptive.looks import Looks

# Each round of a render that may end early has as many samples as all before
GROWTH = 2.0
# With fewer samples of every pixel the error is not looked at: a half has two
ERROR_SAMPLES_LEAST = 4
# Share of the time left that a round is planned to take: what is left is given to ever smaller ones
TIME_SHARE = 0.95


@dataclass(frozen=True)
class Round:
    """A range of samples of every pixel."""

    first: int
    end: int

    @property
    def sample_count(self) -> int:
        """Samples of every pixel."""
        return self.end - self.first

    def of_half(self, half: int, half_count: int) -> Round:
        """Which samples of half `half` these are: sample i is sample i // 2 of half i % 2; with one half alone, all of
        them.
        """
        if half_count == 1:
            return self
        return Round((self.first + 1 - half) // 2, (self.end + 1 - half) // 2)


def sample_marks(wanted: Iterable[int], sample_count: int) -> tuple[int, ...]:
    """The sample counts among `wanted` that a render of `sample_count` samples comes by, ascending."""
    return tuple(sorted({int(samples) for samples in wanted if 0 < samples <= sample_count}))


@dataclass
class RoundPolicy:
    """Says how far the next round goes, and when there is none. Counts are of this render's samples of every pixel."""

    sample_count: int  # asked for
    marks: tuple[int, ...] = ()  # where rounds must end, ascending
    _: KW_ONLY
    time_limit: float = 0.0  # [s]; 0: none
    error_target: float = 0.0  # relMSE; 0: none
    looks: Looks | None = None  # at the noise of pixels, which may end their sampling; None: all get all samples
    # "samples", "error", "noise" or "time", once there is no round any more
    stopped_by: str | None = field(default=None, init=False)
    _seconds_a_sample: float | None = field(default=None, init=False)  # of the last round
    _error: float | None = field(default=None, init=False)  # when it was looked at last
    # Where the error is looked at next. It follows from errors alone: neither marks nor a clock decide what the film is
    _check: int = field(default=0, init=False)

    @staticmethod
    def of(settings: RenderSettings, wanted: Iterable[int], sample_first: int = 0) -> RoundPolicy:
        """For a render whose observers want snapshots at the sample counts `wanted`. From a later sample than 0 on it
        is a part of a round, after which its own samples do not show the noise.
        """
        return RoundPolicy(
            settings.sample_count,
            sample_marks(wanted, settings.sample_count),
            time_limit=settings.time_limit,
            error_target=settings.error_target,
            looks=Looks.of(settings) if sample_first == 0 else None,
        )

    @property
    def is_cut(self) -> bool:
        """Whether there can be more than one round."""
        early = [*self.marks, *([self.looks.first] if self.looks else [])]
        return bool(self.time_limit or self.error_target or any(mark < self.sample_count for mark in early))

    def looks_at_error(self, done: int) -> bool:
        """Whether the error is to be computed after `done` samples."""
        return bool(self.error_target) and done in (self._check, self.sample_count)

    def looks_at_noise(self, done: int) -> bool:
        """Whether pixels may end their sampling after `done` samples."""
        return self.looks is not None and self.looks.last_until(done) == done

    def note_round(self, samples: float, seconds: float, error: float | None) -> None:
        """Remember a round of `samples` samples that took `seconds`, those in the mean over all pixels; `error` is the
        relMSE of all so far, where it was computed.

        Of a round that was finished before the clock began there are none.
        """
        if samples:
            self._seconds_a_sample = seconds / samples
        if error is not None:
            self._error = error

    def resumed(self, settings: RenderSettings, wanted: Iterable[int]) -> RoundPolicy:
        """The policy of a render that goes on, with a clock and observers of its own."""
        policy = RoundPolicy.of(settings, wanted)
        policy._error, policy._check, policy.looks = self._error, self._check, self.looks
        return policy

    def record(self) -> dict[str, Any]:
        """What `resumed` takes over, as JSON has it."""
        return {"error": self._error, "check": self._check, "first_look": self.looks and self.looks.first}

    @staticmethod
    def of_record(sample_count: int, record: dict[str, Any]) -> RoundPolicy:
        """A policy to be `resumed`, from its `record`."""
        first, error = record["first_look"], record["error"]
        policy = RoundPolicy(sample_count, looks=None if first is None else Looks(int(first)))
        policy._error, policy._check = None if error is None else float(error), int(record["check"])
        return policy

    def next_end(self, done: int, seconds: float, share: float = 1.0) -> int | None:
        """Where the round after `done` samples ends, `seconds` after the render began, if `share` of the pixels go on;
        None: the render ends.
        """
        if self.error_target and self._error is not None and self._error <= self.error_target:
            self.stopped_by = "error"
        elif done >= self.sample_count:
            self.stopped_by = "samples"
        elif share == 0.0:
            self.stopped_by = "noise"
        if self.stopped_by:
            return None
        end = self.sample_count
        if self.error_target:
            if done >= self._check:
                self._check = self._end_by_error(done)
            end = min(end, self._check)
        if self.time_limit:
            end = min(end, self._end_by_time(done, seconds, share))
            if end <= done:
                self.stopped_by = "time"
                return None
        if self.looks:
            end = min(end, self.looks.after(done))
        return min([end, *(mark for mark in self.marks if mark > done)])

    def _end_by_error(self, done: int) -> int:
        end = max(ERROR_SAMPLES_LEAST, math.ceil(done * GROWTH))
        if self._error is not None:
            # the squared error of independent samples falls with their number; if it falls faster, one round is too
            # long by little
            needed = self._error / self.error_target * done
            if needed < end:
                end = max(math.ceil(needed), done + done // 8, done + 2)
        return end + end % 2

    def _end_by_time(self, done: int, seconds: float, share: float) -> int:
        if self._seconds_a_sample is None:
            return done + 1  # it is always rendered, and shows how long a sample takes
        left = (self.time_limit - seconds) * TIME_SHARE
        rate = max(self._seconds_a_sample * share, 1e-9)
        fitting = math.floor(min(max(left, 0.0) / rate, self.sample_count))
        return min(math.ceil(done * GROWTH), done + fitting)
