"""Which passes a film has, and where they lie among the channels of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Passes that show what a pixel's paths cost, as the mean over its samples
COST_PASSES = ("Rays", "Node Steps", "Triangle Tests", "Treelet Visits", "Times Queued")
# The pass that shows how many samples each pixel has
SAMPLE_COUNT = "Sample Count"
# Channels of every pass. The first sample alone decides "Depth" and "Position" (an average of them means nothing).
PASSES: dict[str, int] = {
    "Combined": 4,
    "Depth": 1,
    "Position": 3,
    "Normal": 3,
    **dict.fromkeys((*COST_PASSES, SAMPLE_COUNT), 1),
}
FIRST_SAMPLE_PASSES = ("Depth", "Position")


@dataclass(frozen=True)
class ChannelLayout:
    """Where the summed passes lie among the channels of a pixel's sums."""

    transparent: bool  # alpha is summed too; otherwise it is 1
    normal: bool

    @property
    def count(self) -> int:
        """Channels of a pixel."""
        return 3 + self.transparent + 3 * self.normal

    def span(self, name: str) -> slice:
        """Channels of the pass `name`; raises `ValueError` for a pass that is not summed."""
        color = 3 + self.transparent
        if name == "Combined":
            return slice(0, color)
        if name == "Normal":
            return slice(color, color + 3)
        raise ValueError(f"the pass {name!r} has no channels among the sums of a film: give it some in `ChannelLayout`")


def layout_of(passes: tuple[str, ...], transparent: bool) -> ChannelLayout:
    """The layout for these passes."""
    return ChannelLayout(transparent, "Normal" in passes)


def split_passes(
    names: tuple[str, ...],
    layout: ChannelLayout,
    means: np.ndarray,
    single: dict[str, np.ndarray],
    shape: tuple[int, int],
) -> dict[str, np.ndarray]:
    """Passes by name, shape [height, width, channels], from the means of the summed channels and from passes of their
    own.
    """
    means = means.reshape(*shape, layout.count)
    passes = {}
    for name in names:
        if name in single:
            passes[name] = single[name].reshape(*shape, PASSES[name])
            continue
        values = means[..., layout.span(name)]
        if name == "Combined" and not layout.transparent:
            values = np.concatenate([values, np.ones((*shape, 1), np.float32)], axis=-1)
        passes[name] = np.ascontiguousarray(values)
    return passes


def mean_costs(cost: dict[str, np.ndarray], counts: np.ndarray) -> dict[str, np.ndarray]:
    """Cost passes, float32, from sums over `counts` samples, all int64, shape [pixels]; 0 where a pixel has none."""
    return {name: (sums / np.maximum(counts, 1)).astype(np.float32) for name, sums in cost.items()}


def sample_counts(names: tuple[str, ...], counts: np.ndarray) -> dict[str, np.ndarray]:
    """The pass "Sample Count", float32, where it is among `names`, from counts, int64, shape [pixels]."""
    return {SAMPLE_COUNT: counts.astype(np.float32)} if SAMPLE_COUNT in names else {}
