"""Passes as a film shows them, made of the means of its channels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..scene.passes import (
    CAUGHT_LIGHT,
    COLOR_PASSES,
    COST_PASSES,
    DEPTH_OF_NOTHING,
    DIRECT_PASSES,
    FIRST_SAMPLE_PASSES,
    INDIRECT_PASSES,
    PASSES,
    SAMPLE_COUNT,
    VECTOR,
    VECTOR_WEIGHT,
    channels_of,
)
from .caught import CATCHER_PICTURES
from .channels import ChannelLayout

__all__ = ["COST_PASSES", "FIRST_SAMPLE_PASSES", "PASSES", "SAMPLE_COUNT", "channels_of"]

# The colour that light of a pass is divided by
_DIVIDED_BY = dict(zip((*DIRECT_PASSES, *INDIRECT_PASSES), 2 * COLOR_PASSES))


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

    def mean_of(name: str) -> np.ndarray:
        return mean_colors(means, layout) if name == "Combined" else means[..., layout.span(name)]

    passes = {}
    for name in names:
        if name in single:
            passes[name] = single[name].reshape(*shape, channels_of(name))
            continue
        passes[name] = np.ascontiguousarray(shown_pass(name, mean_of, layout))
    return passes


def mean_colors(means: np.ndarray, layout: ChannelLayout) -> np.ndarray:
    """RGBA of pixels, float32, shape [..., 4], from the means of the summed channels, [..., `layout.count`]."""
    colors = means[..., layout.span("Combined")]
    if layout.transparent:
        return colors
    return np.concatenate([colors, np.ones((*colors.shape[:-1], 1), np.float32)], axis=-1)


def shown_pass(name: str, mean_of: Callable[[str], np.ndarray], layout: ChannelLayout) -> np.ndarray:
    """The pass `name` of a film with `layout` as it is shown, float32, of what `mean_of` gives: means of summed passes
    by name, float32, shape [..., channels], of Combined with alpha.
    """
    if CAUGHT_LIGHT in layout.others and name in CATCHER_PICTURES:
        return CATCHER_PICTURES[name](mean_of, layout)
    mean = mean_of(name)
    if name == "Mist":  # what is summed is how clear the view is
        return np.clip(1 - mean, 0, 1)
    if name == VECTOR:
        weight = mean_of(VECTOR_WEIGHT)
        return np.divide(mean, weight, out=np.zeros_like(mean), where=weight > 0)
    if name in _DIVIDED_BY:
        return divided_by_color(mean, mean_of(_DIVIDED_BY[name]))
    return mean


def divided_by_color(light: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Light over the colour of the surfaces that scatter it, float32, both of shape [..., 3]; where a channel has no
    colour, the mean of the others, as in Cycles (`safe_divide_even_color`).
    """
    there = color != 0
    ratio = np.divide(light, color, out=np.zeros_like(light), where=there)
    count = there.sum(-1, keepdims=True, dtype=np.float32)
    grey = ratio.sum(-1, keepdims=True, dtype=np.float32) / np.maximum(count, 1)
    return np.where(there, ratio, grey).astype(np.float32)


def shown_first(first: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Passes of first samples as they are shown, of what the film keeps of them, both float32. It keeps a depth of 0
    where a first sample met no surface: it left the scene, a volume scattered it, or it is not there.
    """
    if "Depth" not in first:
        return first
    depth = first["Depth"]
    return first | {"Depth": np.where(depth == 0, np.float32(DEPTH_OF_NOTHING), depth)}


def mean_costs(cost: dict[str, np.ndarray], counts: np.ndarray) -> dict[str, np.ndarray]:
    """Cost passes, float32, from sums over `counts` samples, all int64, shape [pixels]; 0 where a pixel has none."""
    return {name: (sums / np.maximum(counts, 1)).astype(np.float32) for name, sums in cost.items()}


def sample_counts(names: tuple[str, ...], counts: np.ndarray) -> dict[str, np.ndarray]:
    """The pass "Sample Count", float32, where it is among `names`, from counts, int64, shape [pixels]."""
    return {SAMPLE_COUNT: counts.astype(np.float32)} if SAMPLE_COUNT in names else {}
