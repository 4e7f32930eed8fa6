"""Which samples are rendered next, by whom it may be, and which films are merged. Pure policy, without a cluster."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, replace

# What a task takes, about: so long that its film and its tree cost little beside, so short that progress is seen [s]
TASK_SECONDS = 10.0
# ... and so many times what its film takes beside it
TASK_TIMES_FILM = 8.0
# All bands get some samples before any gets more, which takes about so long: what there is then can be kept [s]. It is
# longer where tasks would be short beside what their films take
LAYER_SECONDS = 30.0
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
    """Samples `first` to `end` - 1 of every pixel of a band."""

    first: int
    end: int
    band: int = 0

    def __str__(self) -> str:
        return f"samples {self.first} to {self.end - 1} of band {self.band}"

    @property
    def count(self) -> int:
        """How many there are."""
        return self.end - self.first


class RangeDeal:
    """Deals the samples `first` to `end` - 1 of all bands, in ranges whose sizes follow what samples took so far: in
    layers of samples, which follow one another in every band. As long as none was rendered, one of a band should take
    `like` [s].
    """

    def __init__(self, first: int, end: int, bands: int = 1, like: float | None = None):
        self.first, self.end, self.bands, self.like = first, end, bands, like
        # the samples that are being dealt, to which band, and from which of them on
        self._layer, self._band, self._next = (first, first), bands, first
        self._seconds, self._samples = 0.0, 0  # of samples that were rendered
        self._beside: float | None = None  # what a task takes beside them, at least, if that is known [s]

    @property
    def dealt(self) -> float:
        """The end of the samples that were dealt, where all pixels had the same."""
        return self.end - self._left / self.bands

    @property
    def is_dealt(self) -> bool:
        """Whether no samples are left to deal."""
        return not self._left

    @property
    def layer_end(self) -> int:
        """The end of the samples that are being dealt, which no range crosses, nor any that was dealt."""
        return self._layer[1]

    @property
    def _left(self) -> int:
        """Samples of a band each that are left to deal."""
        (first, end), bands = self._layer, self.bands
        return (self.end - end) * bands + (end - first) * (bands - self._band) - (self._next - first)

    @property
    def sample_seconds(self) -> float | None:
        """What a sample of a band takes a worker in the mean [s]; None as long as none was rendered."""
        return self._seconds / self._samples if self._samples else None

    @property
    def _sample_seconds(self) -> float | None:
        """The same, or what it should be; None where neither is known, or both are too little to be measured."""
        return self.sample_seconds or self.like or None

    def note(self, samples: SampleRange, seconds: float, beside: float | None) -> None:
        """To render `samples` took a worker so long [s], with a film and a scene that were there, and `beside` went to
        the film and the scene; None where kernels were loaded and trees were built too, as no later task has to.
        """
        if beside is not None:
            self._beside = beside if self._beside is None else min(self._beside, beside)
        self._seconds, self._samples = self._seconds + seconds, self._samples + samples.count

    def next(self, workers: int) -> SampleRange | None:
        """The samples of the next task, where `workers` share what is left; None where all are dealt.

        As long as nobody knows what a sample takes, a task has one sample, or the workers' part of a hundredth.
        """
        left, workers = self._left, max(workers, 1)
        if left <= 0:
            return None
        if self._band == self.bands:
            self._begin_layer(workers)
        most, a_sample = math.ceil(left / workers * TASK_LEFT_SHARE), self._sample_seconds
        if a_sample is None:
            wanted = (self.end - self.first) * self.bands / (100 * workers)
        else:
            wanted = self._task_seconds / a_sample
            most = max(most, math.floor(max(LEAST_SECONDS, self._beside or 0.0) / a_sample))
        count = max(1, min(most, self._layer[1] - self._next, math.floor(wanted)))
        dealt = SampleRange(self._next, self._next + count, self._band)
        self._next = dealt.end
        if self._next == self._layer[1]:
            self._band, self._next = self._band + 1, self._layer[0]
        return dealt

    @property
    def _task_seconds(self) -> float:
        return max(TASK_SECONDS, self._film_seconds)

    @property
    def _film_seconds(self) -> float:
        """Tasks that take so long are long beside what their films take."""
        return TASK_TIMES_FILM * (self._beside or 0.0)

    def _begin_layer(self, workers: int) -> None:
        """The next samples for each band. The first layer of several bands tells what a sample takes."""
        first, a_sample = self._layer[1], self._sample_seconds
        left = count = self.end - first
        if self.bands > 1:
            count = 1
            if a_sample is not None:
                count = math.floor(max(LAYER_SECONDS * workers / self.bands, self._film_seconds) / a_sample)
            count = left if 2 * left < 3 * count else max(count, 1)
        self._layer, self._band, self._next = (first, first + count), 0, first

    def cut(self, samples: SampleRange) -> list[SampleRange]:
        """`samples` in ranges of a task each, to render them again."""
        a_sample = self._sample_seconds
        count = samples.count if a_sample is None else max(1, math.floor(self._task_seconds / a_sample))
        firsts = range(samples.first, samples.end, count)
        return [replace(samples, first=first, end=min(first + count, samples.end)) for first in firsts]

    def is_late(self, samples: SampleRange, seconds: float) -> bool:
        """Whether a task with `samples` that was begun `seconds` ago should be rendered elsewhere too."""
        a_sample = self.sample_seconds
        if a_sample is None:
            return False
        return seconds > max(STRAGGLER_SECONDS, STRAGGLER_TIMES * samples.count * a_sample)


class MergeTree:
    """Ranges whose films are there, and which of them are merged next: neighbours in a band of about equally many
    tasks, so that no film is merged more often than the logarithm of their number says.
    """

    def __init__(self) -> None:
        self._ranks: dict[SampleRange, int] = {}  # of those that wait: how often they were merged
        self._firsts: dict[tuple[int, int], SampleRange] = {}  # the same, by band and first sample
        self._ends: dict[tuple[int, int], SampleRange] = {}
        # a heap of those whose neighbours were not looked at since they came, which were merged least first
        self._unseen: list[tuple[int, SampleRange]] = []
        self._flush = False
        self._border: int | None = None  # films before this sample are merged to one, and with none behind it

    def add(self, samples: SampleRange, rank: int = 0) -> None:
        """The film of `samples` is there, merged `rank` times."""
        self._ranks[samples] = rank
        self._firsts[samples.band, samples.first] = self._ends[samples.band, samples.end] = samples
        heapq.heappush(self._unseen, (rank, samples))

    def remove(self, samples: SampleRange) -> None:
        """Its film is merged elsewhere."""
        del self._ranks[samples], self._firsts[samples.band, samples.first], self._ends[samples.band, samples.end]

    def take_pair(self, flush: bool = False) -> tuple[SampleRange, SampleRange, int] | None:
        """Two neighbours to merge now, and the rank of what comes of them; None where none should be. With `flush` any
        neighbours are, since no more will come.
        """
        if flush != self._flush:
            self._flush = flush
            self._look_again()
        while self._unseen:
            _, each = self._unseen[0]
            before, behind = self._ends.get((each.band, each.first)), self._firsts.get((each.band, each.end))
            pairs = [(before, each), (each, behind)] if each in self._ranks else []
            pairs = [(self._rank(a, b), a, b) for a, b in pairs if a and b and self._may_merge(a, b)]
            if not pairs:
                heapq.heappop(self._unseen)
                continue
            rank, earlier, later = min(pairs)
            self.remove(earlier)
            self.remove(later)
            return earlier, later, rank
        return None

    def _rank(self, earlier: SampleRange, later: SampleRange) -> int:
        return max(self._ranks[earlier], self._ranks[later]) + 1

    def _may_merge(self, earlier: SampleRange, later: SampleRange) -> bool:
        if self._border is not None and earlier.first < self._border < later.end:
            return False
        is_before = self._border is not None and later.end <= self._border
        return self._flush or is_before or self._ranks[earlier] == self._ranks[later]

    def _look_again(self) -> None:
        """At all that wait."""
        self._unseen = sorted((rank, each) for each, rank in self._ranks.items())

    def take_following(self, first: int, bands: int, layer_end: int) -> list[SampleRange]:
        """The films of all bands whose samples begin with `first` and have one end. Where their ends differ there are
        none now, and films are merged up to `layer_end`, which none crosses.
        """
        following = sorted((each for each in self._ranks if each.first == first), key=lambda each: each.band)
        if len(following) < bands:
            return []
        if len({each.end for each in following}) > 1:
            if self._border is None:
                self._border = layer_end
                self._look_again()
            return []
        if self._border is not None:
            self._border = None
            self._look_again()
        for each in following:
            self.remove(each)
        return following
