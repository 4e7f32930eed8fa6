"""Which samples are rendered next, by whom it may be, and which films are merged. Pure policy, without a cluster."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

# What a task takes, about: so long that its film and its tree cost little beside, so short that progress is seen [s]
TASK_SECONDS = 10.0
# The last ones are not shorter than this, where they have more than one sample [s]
LEAST_SECONDS = 0.5
# Of its part of all samples that are left, a task has at most this share: the last ones are short
TASK_LEFT_SHARE = 0.5
# A task that takes so many times what it should is rendered elsewhere too, once nothing else is left
STRAGGLER_TIMES = 2.0
# Nor sooner than this after it was begun [s]
STRAGGLER_SECONDS = 2.0


@dataclass(frozen=True, order=True)
class SampleRange:
    """Samples `first` to `end` - 1 of every pixel."""

    first: int
    end: int

    @property
    def count(self) -> int:
        """How many there are."""
        return self.end - self.first


@dataclass
class RangeDeal:
    """Deals the samples `first` to `end` - 1 in order, in ranges whose sizes follow what samples took so far."""

    first: int
    end: int
    task_seconds: float = TASK_SECONDS
    like: float | None = None  # what a sample should take, as long as none was rendered [s]
    _next: int = field(init=False)
    _seconds: float = 0.0  # of samples that were rendered
    _samples: int = 0

    def __post_init__(self) -> None:
        self._next = self.first

    @property
    def dealt(self) -> int:
        """The end of the samples that were dealt."""
        return self._next

    @property
    def is_dealt(self) -> bool:
        """Whether no samples are left to deal."""
        return self._next >= self.end

    @property
    def sample_seconds(self) -> float | None:
        """What a sample of every pixel takes a worker in the mean [s]; None as long as none was rendered."""
        return self._seconds / self._samples if self._samples else None

    @property
    def _sample_seconds(self) -> float | None:
        """The same, or what it should be."""
        return self.sample_seconds or self.like

    def note(self, samples: SampleRange, seconds: float) -> None:
        """To render `samples` took a worker so long [s], with a film and a scene that were there."""
        self._seconds, self._samples = self._seconds + seconds, self._samples + samples.count

    def next(self, workers: int) -> SampleRange | None:
        """The samples of the next task, where `workers` share what is left; None where all are dealt.

        As long as nobody knows what a sample takes, a task has one sample, or the workers' part of a hundredth.
        """
        left = self.end - self._next
        if left <= 0:
            return None
        most, a_sample = math.ceil(left / max(workers, 1) * TASK_LEFT_SHARE), self._sample_seconds
        if a_sample is None:
            wanted = (self.end - self.first) / (100 * max(workers, 1))
        else:
            wanted = self.task_seconds / a_sample
            most = max(most, math.floor(LEAST_SECONDS / a_sample))
        count = max(1, min(most, left, math.floor(wanted)))
        dealt = SampleRange(self._next, self._next + count)
        self._next = dealt.end
        return dealt

    def cut(self, samples: SampleRange) -> list[SampleRange]:
        """`samples` in ranges of a task each, to render them again."""
        a_sample = self._sample_seconds
        count = samples.count if a_sample is None else max(1, math.floor(self.task_seconds / a_sample))
        return [SampleRange(i, min(i + count, samples.end)) for i in range(samples.first, samples.end, count)]

    def is_late(self, samples: SampleRange, seconds: float) -> bool:
        """Whether a task with `samples` that was begun `seconds` ago should be rendered elsewhere too."""
        a_sample = self.sample_seconds
        if a_sample is None:
            return False
        return seconds > max(STRAGGLER_SECONDS, STRAGGLER_TIMES * samples.count * a_sample)


class MergeTree:
    """Ranges whose films are there, and which of them are merged next: neighbours of about equally many tasks, so that
    no film is merged more often than the logarithm of their number says.
    """

    def __init__(self) -> None:
        self._ranks: dict[SampleRange, int] = {}  # of those that wait: how often they were merged

    def add(self, samples: SampleRange, rank: int = 0) -> None:
        """The film of `samples` is there, merged `rank` times."""
        self._ranks[samples] = rank

    def take_pair(self, flush: bool = False) -> tuple[SampleRange, SampleRange, int] | None:
        """Two neighbours to merge now, and the rank of what comes of them; None where none should be. With `flush` any
        neighbours are, since no more will come.
        """
        ranks, ends = self._ranks, {each.end: each for each in self._ranks}
        pairs = [(earlier, later) for later in sorted(ranks) if (earlier := ends.get(later.first)) is not None]
        pairs = [(a, b) for a, b in pairs if flush or ranks[a] == ranks[b]]
        if not pairs:
            return None
        earlier, later = min(pairs, key=lambda pair: max(ranks[pair[0]], ranks[pair[1]]))
        return earlier, later, max(ranks.pop(earlier), ranks.pop(later)) + 1

    def remove(self, samples: SampleRange) -> None:
        """Its film is merged elsewhere."""
        del self._ranks[samples]
