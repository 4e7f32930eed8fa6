"""Samples of a film in the host's memory: merged, cut into tiles, and brought back to a device."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .layout import COST_PASSES, FIRST_SAMPLE_PASSES, channels_of, mean_costs, sample_counts, shown_first
from .mattes import Mattes
from .sums import ExactSums, no_wide


@dataclass(frozen=True)
class HostSamples:
    """Sums, counts and first samples in the host's memory."""

    sums: ExactSums
    counts: np.ndarray  # int64, shape [pixels]
    first: dict[str, np.ndarray]  # float32, shape [pixels * channels]
    cost: dict[str, np.ndarray]  # sums of cost passes, int64, shape [pixels]
    mattes: Mattes = field(default_factory=Mattes)

    @staticmethod
    def zeros(pixel_count: int, channels: int, pass_names: tuple[str, ...]) -> HostSamples:
        """No samples of so many pixels, with `channels` summed channels each."""
        first = {
            name: np.zeros(pixel_count * channels_of(name), np.float32)
            for name in pass_names
            if name in FIRST_SAMPLE_PASSES
        }
        cost = {name: np.zeros(pixel_count, np.int64) for name in pass_names if name in COST_PASSES}
        return HostSamples(ExactSums.zeros(pixel_count, channels), np.zeros(pixel_count, np.int64), first, cost)

    def add(self, other: HostSamples) -> HostSamples:
        """The samples of both. Of a pixel that has its first sample in both, this one's counts."""
        # a pixel without a first sample has 0 in all channels of all passes, also where it has later samples
        own = np.zeros(len(self.counts), bool)
        for name, values in self.first.items():
            own |= (values.reshape(len(own), channels_of(name)) != 0).any(1)

        def first_of(name: str, values: np.ndarray) -> np.ndarray:
            return np.where(np.repeat(own, channels_of(name)), values, other.first[name])

        return HostSamples(
            self.sums.add(other.sums),
            self.counts + other.counts,
            {name: first_of(name, values) for name, values in self.first.items()},
            {name: sums + other.cost[name] for name, sums in self.cost.items()},
            self.mattes.plus(other.mattes),
        )

    def part(self, pixels: np.ndarray, matte_kinds: int = 0) -> HostSamples:
        """Samples of some pixels, in the order of `pixels`; `matte_kinds`: how many kinds of mattes there are."""
        channels = self.sums.channels

        def cells(sums: np.ndarray) -> np.ndarray:
            return np.ascontiguousarray(sums.reshape(len(sums), -1, channels)[:, pixels].reshape(len(sums), -1))

        wide = cells(self.sums.wide) if len(self.sums.wide) else no_wide()
        return HostSamples(
            ExactSums(cells(self.sums.window), wide if wide.any() else no_wide(), channels),
            self.counts[pixels],
            {name: values.reshape(-1, channels_of(name))[pixels].reshape(-1) for name, values in self.first.items()},
            {name: values[pixels] for name, values in self.cost.items()},
            self.mattes.part(pixels, matte_kinds),
        )

    def single(self, pass_names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Values of the passes that are no means of summed channels, float32, shape [pixels * channels]."""
        costs = mean_costs(self.cost, self.counts) | sample_counts(pass_names, self.counts)
        return shown_first(self.first) | costs | self.mattes.passes(pass_names, self.counts)
