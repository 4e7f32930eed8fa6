"""Shadow catchers in films, shown as by Cycles (`film_calculate_shadow_catcher` in `kernel/film/read.h`).

A path that meets a catcher before it scatters brings light L to the picture; its copy, for which there are catchers
alone, brings A. So L / A of a pixel is how much darker, or brighter, catchers are by what else is there: the pass
Shadow Catcher, by which a photograph is multiplied. Combined has what is no catcher, and nothing where catchers are,
which its alpha says; or the shadows lie there as black that covers what is behind, by the mean of the channels.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..scene.passes import CATCHER_ALPHA, CATCHER_LIGHT, CATCHER_PASS, CATCHER_SHADOWS, CAUGHT_LIGHT, CAUGHT_WORLD
from .channels import ChannelLayout

Means = Callable[[str], np.ndarray]


def _catcher_pass(mean_of: Means, layout: ChannelLayout) -> np.ndarray:
    """Light over light without other objects; 1 where there is none, and where the film shows no surface."""
    light, alone = mean_of(CAUGHT_LIGHT), mean_of(CATCHER_LIGHT)
    with np.errstate(over="ignore"):  # nearly no light alone
        share = np.divide(light, alone, out=np.ones_like(light), where=alone != 0)
    share = np.clip(share, None, np.finfo(np.float32).max)
    alpha = np.clip(mean_of("Combined")[..., 3:], 0, 1)
    return (1 - alpha) + alpha * share


def _shadows(mean_of: Means, layout: ChannelLayout) -> np.ndarray:
    """How dark the shadows of catchers are, 0 to 1."""
    return 1 - np.clip(_catcher_pass(mean_of, layout).mean(-1, keepdims=True, dtype=np.float32), 0, 1)


def _combined(mean_of: Means, layout: ChannelLayout) -> np.ndarray:
    """What is no catcher; with the shadows of catchers where the film shows these in Combined."""
    whole = mean_of("Combined")
    color = whole[..., :3] - mean_of(CAUGHT_LIGHT)
    alpha = whole[..., 3:] - mean_of(CATCHER_ALPHA)
    if CAUGHT_WORLD in layout.others:
        shadows = _shadows(mean_of, layout)
        if layout.transparent:
            alpha = np.clip(alpha, 0, 1)
            alpha = alpha + (1 - alpha) * shadows
        else:
            color, alpha = color + mean_of(CAUGHT_WORLD) * (1 - shadows), np.ones_like(alpha)
    return np.concatenate([color, alpha], axis=-1)


# By name: functions (means, layout) of the passes that catchers are shown by
CATCHER_PICTURES: dict[str, Callable[[Means, ChannelLayout], np.ndarray]] = {
    "Combined": _combined,
    CATCHER_PASS: _catcher_pass,
    CATCHER_SHADOWS: _shadows,
}
