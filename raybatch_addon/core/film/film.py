"""The result of a render: passes, and the exact sums that they are made of."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RayBatchError
from ..scene.description import Frame
from .layout import COST_PASSES, FIRST_SAMPLE_PASSES, PASSES, ChannelLayout, layout_of, split_passes
from .sums import WIDE_DIGITS, ExactSums, means_of, no_wide, normalised
from .tile import FinishedTile, HostSamples


@dataclass
class Film:
    """Passes of the rendered region, bottom row first, and how they came about.

    Tiles keep their sums on the device that rendered them until `sums`, `counts` or `first` is asked for.
    """

    width: int  # of the full frame [pixels]
    height: int
    region: tuple[int, int, int, int]  # x0, y0, x1, y1 [pixels]
    pass_names: tuple[str, ...]
    layout: ChannelLayout
    samples: HostSamples  # of the region, but for those of `tiles`
    complete: bool = True  # every sample asked for is there
    statistics: dict[str, Any] = field(default_factory=dict)
    resume_state: Any = None  # what `Session.render(resume=...)` needs; None when complete
    tiles: list[FinishedTile] = field(default_factory=list, repr=False)  # whose samples are not in `samples` yet
    # The pictures, while every pixel has the samples of one tile alone; None: they are made of the sums
    picture: dict[str, np.ndarray] | None = field(default=None, repr=False)

    @staticmethod
    def empty(frame: Frame) -> Film:
        """A film of `frame` without samples."""
        x0, y0, x1, y1 = frame.region
        layout = layout_of(frame.passes, frame.transparent)
        pixel_count = (x1 - x0) * (y1 - y0)
        first = {n: np.zeros(pixel_count * PASSES[n], np.float32) for n in frame.passes if n in FIRST_SAMPLE_PASSES}
        cost = {name: np.zeros(pixel_count, np.int64) for name in frame.passes if name in COST_PASSES}
        samples = HostSamples(ExactSums.zeros(pixel_count, layout.count), np.zeros(pixel_count, np.int64), first, cost)
        return Film(frame.width, frame.height, frame.region, tuple(frame.passes), layout, samples)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the region [pixels]."""
        x0, y0, x1, y1 = self.region
        return y1 - y0, x1 - x0

    @property
    def sums(self) -> ExactSums:
        """Exact sums of all summed channels over the region."""
        return self._fetched().sums

    @property
    def counts(self) -> np.ndarray:
        """Samples of each pixel, int64, shape [region pixels]."""
        return self._fetched().counts

    @property
    def first(self) -> dict[str, np.ndarray]:
        """First-sample passes by name, float32, shape [region pixels * channels]."""
        return self._fetched().first

    @property
    def sample_count(self) -> int:
        """Samples of the pixel that has fewest."""
        return int(self.counts.min(initial=np.iinfo(np.int64).max)) if self.counts.size else 0

    @property
    def sample_total(self) -> int:
        """Samples of all pixels together."""
        return int(self.samples.counts.sum()) + sum(tile.sample_count for tile in self.tiles)

    @property
    def passes(self) -> dict[str, np.ndarray]:
        """Linear float32 arrays by name, shape [region height, region width, channels]."""
        if self.picture is not None:
            return dict(self.picture)
        means = means_of(self.sums.window, self.sums.wide, self.counts, self.layout.count)
        return split_passes(self.pass_names, self.layout, means, self._fetched().single, self.shape)

    def add_tile(self, tile: FinishedTile) -> dict[str, np.ndarray]:
        """Add the samples of `tile`; returns the passes of its rectangle."""
        untouched = self.picture is None and not self.tiles and not self.samples.counts.any()
        self.tiles.append(tile)
        if untouched or self.picture is not None:
            self._show(tile)
            return tile.passes
        return self.part(tile.x, tile.y, tile.width, tile.height)

    def part(self, x: int, y: int, width: int, height: int) -> dict[str, np.ndarray]:
        """`passes` of the rectangle whose bottom left is frame pixel (x, y)."""
        left, bottom = x - self.region[0], y - self.region[1]
        if self.picture is not None:
            return {name: values[bottom : bottom + height, left : left + width] for name, values in self.picture.items()}
        place, channels = self._place(x, y, width, height), self.layout.count

        def cells(sums: np.ndarray) -> np.ndarray:
            return np.ascontiguousarray(sums.reshape(len(sums), -1, channels)[:, place].reshape(len(sums), -1))

        wide = cells(self.sums.wide) if len(self.sums.wide) else no_wide()
        means = means_of(cells(self.sums.window), wide, self.counts[place], channels)
        single = {name: values.reshape(-1, PASSES[name])[place] for name, values in self._fetched().single.items()}
        return split_passes(self.pass_names, self.layout, means, single, (height, width))

    def merge(self, other: Film) -> Film:
        """The film of both films' samples, bit for bit that of one render; they must show the same region and passes."""
        if (self.width, self.height, self.region, self.pass_names, self.layout) != (
            other.width, other.height, other.region, other.pass_names, other.layout,
        ):  # fmt: skip
            raise RayBatchError("these films cannot be merged: they differ in size, region or passes; render both alike")
        samples = HostSamples(
            self.sums.add(other.sums),
            self.counts + other.counts,
            # of a pixel that has its first sample in both films, this one's counts
            {name: np.where(self.first[name] != 0, self.first[name], other.first[name]) for name in self.first},
            {name: sums + other.samples.cost[name] for name, sums in self.samples.cost.items()},
        )
        return Film(
            self.width, self.height, self.region, self.pass_names, self.layout, samples,
            complete=self.complete and other.complete, statistics=dict(self.statistics),
        )  # fmt: skip

    def save_npz(self, path: str | Path) -> None:
        """Write the passes as arrays by name, linear float32 [height, width, channels], bottom row first."""
        with open(path, "wb") as file:
            np.savez_compressed(file, **self.passes)

    # --- tiles

    def _show(self, tile: FinishedTile) -> None:
        if (tile.height, tile.width) == self.shape:
            self.picture = tile.passes
            return
        if self.picture is None:
            self.picture = {name: np.zeros((*self.shape, PASSES[name]), np.float32) for name in self.pass_names}
            if not self.layout.transparent and "Combined" in self.picture:
                self.picture["Combined"][..., 3] = 1
        for name, place in self.part(tile.x, tile.y, tile.width, tile.height).items():
            place[:] = tile.passes[name]

    def _fetched(self) -> HostSamples:
        """All samples in the host's memory."""
        while self.tiles:
            # a tile that cannot be fetched stays, and is asked for again
            self._add_samples(self.tiles[-1], self.tiles[-1].fetch())
            self.tiles.pop()
        return self.samples

    def _add_samples(self, tile: FinishedTile, samples: HostSamples) -> None:
        place, channels = self._place(tile.x, tile.y, tile.width, tile.height), self.layout.count
        sums = self.samples.sums
        if len(samples.sums.wide) and not len(sums.wide):
            sums.wide = np.zeros((WIDE_DIGITS, sums.window.shape[1]), np.int64)
        for mine, theirs in ((sums.window, samples.sums.window), (sums.wide, samples.sums.wide)):
            if len(theirs):
                cells = mine.reshape(len(mine), -1, channels)
                cells[:, place] = normalised(cells[:, place] + theirs.reshape(len(mine), -1, channels))
        self.samples.counts[place] += samples.counts
        for name, values in samples.first.items():
            self.samples.first[name].reshape(-1, PASSES[name])[place] += values.reshape(-1, PASSES[name])
        for name, values in samples.cost.items():
            self.samples.cost[name][place] += values

    def _place(self, x: int, y: int, width: int, height: int) -> np.ndarray:
        rows = np.arange(y - self.region[1], y - self.region[1] + height)
        return (rows[:, None] * self.shape[1] + np.arange(width) + (x - self.region[0])).ravel()
