"""Films of one scene, which should be equal bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
from lib.films import differing_pixels

from raybatch_addon.core.film import Film


class FilmsCompared:
    """Looks at every film; the first is what the others should be."""

    def __init__(self) -> None:
        self._first: dict[str, np.ndarray] = {}
        self._count = 0
        self._differences: list[str] = []

    def take(self, name: str, film: Film) -> None:
        """The film of a render called `name`. Only its passes are kept, and only the first's."""
        self._count += 1
        passes = film.passes
        if not self._first:
            self._first = passes
        if not film.complete:
            self._differences.append(f"{name}: samples are missing")
        for which, expected in self._first.items():
            differing = differing_pixels(passes[which], expected)
            if differing:
                self._differences.append(f"{name}: {differing:,} of {expected[..., 0].size:,} pixels of {which} differ")

    def report(self) -> dict[str, Any]:
        """What was found."""
        return {
            "compared": self._count,
            "equal": not self._differences,
            "differences": list(dict.fromkeys(self._differences)),
        }
