"""The result of a render: passes, and the exact sums that they are made of."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from ..errors import RayBatchError
from ..scene.description import Frame
from ..scene.passes import CAUGHT_LIGHT, matte_kinds
from .channels import ChannelLayout, layout_of
from .host_samples import HostSamples
from .layout import channels_of, mean_colors, split_passes
from .sums import WIDE_DIGITS, ExactSums, means_of, normalised
from .tile import FinishedTile


@dataclass(kw_only=True)
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
    # By rectangle; their samples are not in `samples` yet
    tiles: dict[tuple[int, int, int, int], FinishedTile] = field(default_factory=dict, repr=False)
    # The pictures, while every pixel has the samples of one tile alone; None: they are made of the sums
    picture: dict[str, np.ndarray] | None = field(default=None, repr=False)
    # Films of either half of the samples, with seeds of their own, whose exact sum this is; None: all samples are here.
    # The second half has none of the passes that the first sample decides
    halves: tuple[Film, Film] | None = field(default=None, repr=False)
    # What was made of the passes when all was there, by name: a denoised picture, and the noisy one
    made: dict[str, np.ndarray] = field(default_factory=dict, repr=False)
    _sum: HostSamples | None = field(default=None, repr=False)  # of the halves, where it was asked for

    @staticmethod
    def empty(frame: Frame, half_count: int = 1) -> Film:
        """A film of `frame` without samples; with `half_count` 2 those to come are kept in two halves."""
        x0, y0, x1, y1 = frame.region
        layout = layout_of(frame.passes, frame.transparent)
        samples = HostSamples.zeros((x1 - x0) * (y1 - y0), layout.count, tuple(frame.passes))
        film = Film(
            width=frame.width,
            height=frame.height,
            region=frame.region,
            pass_names=tuple(frame.passes),
            layout=layout,
            samples=samples,
        )
        if half_count == 2:
            film.halves = (Film.empty(frame), Film.empty(frame))
        return film

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the region [pixels]."""
        x0, y0, x1, y1 = self.region
        return y1 - y0, x1 - x0

    @property
    def sums(self) -> ExactSums:
        """Exact sums of all summed channels over the region."""
        return self.fetched().sums

    @property
    def counts(self) -> np.ndarray:
        """Samples of each pixel, int64, shape [region pixels]."""
        return self.fetched().counts

    @property
    def first(self) -> dict[str, np.ndarray]:
        """First-sample passes by name, float32, shape [region pixels * channels]."""
        return self.fetched().first

    @property
    def sample_count(self) -> int:
        """Samples of the pixel that has fewest."""
        return int(self.counts.min(initial=np.iinfo(np.int64).max)) if self.counts.size else 0

    @property
    def sample_share(self) -> np.ndarray:
        """Samples of each pixel over those of the pixel that has most, float32, shape [height, width, 1]."""
        counts = self.counts.astype(np.float64)
        return (counts / max(counts.max(initial=0.0), 1.0)).astype(np.float32).reshape(*self.shape, 1)

    @property
    def sample_total(self) -> int:
        """Samples of all pixels together."""
        if self.halves:
            return sum(half.sample_total for half in self.halves)
        return int(self.samples.counts.sum()) + sum(tile.sample_count for tile in self.tiles.values())

    @property
    def passes(self) -> dict[str, np.ndarray]:
        """Linear float32 arrays by name, shape [region height, region width, channels]."""
        if self.picture is not None:
            return dict(self.picture)
        means = means_of(self.sums.window, self.sums.wide, self.counts, self.layout.count)
        return split_passes(self.pass_names, self.layout, means, self.fetched().single(self.pass_names), self.shape)

    @property
    def colors(self) -> np.ndarray:
        """RGBA of each pixel by the light of all its paths, float32, shape [height, width, 4]: "Combined", with shadow
        catchers as surfaces like others.
        """
        if CAUGHT_LIGHT not in self.layout.others:
            return self.passes["Combined"]
        means = means_of(self.sums.window, self.sums.wide, self.counts, self.layout.count)
        return mean_colors(means.reshape(*self.shape, self.layout.count), self.layout)

    @property
    def shown(self) -> dict[str, np.ndarray]:
        """`passes`, with what was made of them in their place."""
        return self.passes | self.made

    def add_tile(self, tile: FinishedTile) -> dict[str, np.ndarray]:
        """Add the samples of `tile`, or replace the tile that it went on from by it; returns the passes of its
        rectangle.
        """
        untouched = self.picture is None and not self.tiles and not self.samples.counts.any()
        if self.halves:
            for half, part in zip(self.halves, tile.halves, strict=True):
                half.add_tile(part)
            self._sum = None
        self.tiles[tile.rectangle] = tile
        if untouched or self.picture is not None:
            self._show(tile)
            return tile.passes
        return self.part(tile.x, tile.y, tile.width, tile.height)

    def part(self, x: int, y: int, width: int, height: int) -> dict[str, np.ndarray]:
        """`passes` of the rectangle whose bottom left is frame pixel (x, y)."""
        left, bottom = x - self.region[0], y - self.region[1]
        if self.picture is not None:
            return {
                name: values[bottom : bottom + height, left : left + width] for name, values in self.picture.items()
            }
        samples = self.fetched().part(self._pixels(x, y, width, height), self._matte_kinds)
        means = means_of(samples.sums.window, samples.sums.wide, samples.counts, self.layout.count)
        return split_passes(self.pass_names, self.layout, means, samples.single(self.pass_names), (height, width))

    def merge(self, other: Film) -> Film:
        """The film of both films' samples, bit for bit that of one render; they must show the same region and passes.

        Halves stay apart where both films have them. Statistics are those of this film alone, its error among them.
        """
        if (self.width, self.height, self.region, self.pass_names, self.layout) != (
            other.width,
            other.height,
            other.region,
            other.pass_names,
            other.layout,
        ):
            raise RayBatchError(
                "these films cannot be merged: they differ in size, region or passes; render both alike"
            )
        merged = Film(
            width=self.width,
            height=self.height,
            region=self.region,
            pass_names=self.pass_names,
            layout=self.layout,
            samples=self.fetched().add(other.fetched()),
            complete=self.complete and other.complete,
            statistics=dict(self.statistics),
        )
        if self.halves and other.halves:
            merged.halves = (self.halves[0].merge(other.halves[0]), self.halves[1].merge(other.halves[1]))
            merged._sum = merged.samples
        return merged

    def tile_on(self, rectangle: tuple[int, int, int, int], device: wp.Device) -> FinishedTile:
        """The samples of the `rectangle` (x, y, width, height in the frame) as a tile on `device` that more can
        be added to.
        """
        if self.halves:
            return FinishedTile.sum_of(*(half.tile_on(rectangle, device) for half in self.halves))
        return FinishedTile.on_device(
            rectangle,
            self.fetched().part(self._pixels(*rectangle), self._matte_kinds),
            self.layout,
            self.pass_names,
            device,
        )

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
            self.picture = {name: np.zeros((*self.shape, channels_of(name)), np.float32) for name in self.pass_names}
            if not self.layout.transparent and "Combined" in self.picture:
                self.picture["Combined"][..., 3] = 1
        for name, pixels in self.part(tile.x, tile.y, tile.width, tile.height).items():
            pixels[:] = tile.passes[name]

    def fetched(self) -> HostSamples:
        """All samples in the host's memory."""
        if self.halves:
            if self._sum is None:
                self._sum = self.halves[0].fetched().add(self.halves[1].fetched())
            return self._sum
        while self.tiles:
            # a tile that cannot be fetched stays, and is asked for again
            rectangle = next(iter(self.tiles))
            self._add_samples(self.tiles[rectangle], self.tiles[rectangle].fetch())
            del self.tiles[rectangle]
        return self.samples

    def _add_samples(self, tile: FinishedTile, samples: HostSamples) -> None:
        pixels, channels = self._pixels(tile.x, tile.y, tile.width, tile.height), self.layout.count
        sums = self.samples.sums
        if len(samples.sums.wide) and not len(sums.wide):
            sums.wide = np.zeros((WIDE_DIGITS, sums.window.shape[1]), np.int64)
        for mine, theirs in ((sums.window, samples.sums.window), (sums.wide, samples.sums.wide)):
            if len(theirs):
                cells = mine.reshape(len(mine), -1, channels)
                cells[:, pixels] = normalised(cells[:, pixels] + theirs.reshape(len(mine), -1, channels))
        self.samples.counts[pixels] += samples.counts
        for name, values in samples.first.items():
            self.samples.first[name].reshape(-1, channels_of(name))[pixels] += values.reshape(-1, channels_of(name))
        for name, values in samples.cost.items():
            self.samples.cost[name][pixels] += values
        if len(samples.mattes.cell):
            mattes = self.samples.mattes.plus(samples.mattes.moved(pixels, self._matte_kinds))
            self.samples = dataclasses.replace(self.samples, mattes=mattes)

    @property
    def _matte_kinds(self) -> int:
        return len(matte_kinds(self.pass_names))

    def _pixels(self, x: int, y: int, width: int, height: int) -> np.ndarray:
        rows = np.arange(y - self.region[1], y - self.region[1] + height)
        return (rows[:, None] * self.shape[1] + np.arange(width) + (x - self.region[0])).ravel()
