"""FLIP, the error as an eye sees it that flickers between two pictures, by the package flip-evaluator where it is
installed.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

MISSING = "FLIP is left out: the package flip-evaluator is not installed (pip install flip-evaluator)"


def flip_function() -> Callable[[np.ndarray, np.ndarray], float | None] | None:
    """The mean HDR-FLIP of a picture against a reference, both linear float32 [height, width, 3], top row first; None:
    not installed.

    Exposures follow from the reference alone (Andersson et al. 2021, "Visualizing errors in rendered high dynamic range
    images"), at the package's 67 pixels a degree. Against a reference without light there is none: the function gives
    None then.
    """
    try:
        import flip_evaluator
    except ImportError:
        return None

    def flip(picture: np.ndarray, reference: np.ndarray) -> float | None:
        # it takes values from 0 on; wide filters make none below, but a reference from elsewhere may have them
        test, truth = (np.ascontiguousarray(np.maximum(each, 0), np.float32) for each in (picture, reference))
        if not truth.any():
            return None
        value = flip_evaluator.evaluate(truth, test, "HDR", inputsRGB=False, applyMagma=False)[1]
        return value if math.isfinite(value) else None

    return flip
