"""Which policies there are that the host asks."""

from __future__ import annotations

from ..policy import Selection
from .balanced import Balanced
from .drawn import Drawn
from .every import Every
from .fullest import Fullest
from .in_turn import InTurn
from .interface import Assignment
from .lazy import Lazy

SEVERAL = (Selection.LAZY, Selection.BALANCED)
"""Selections that serve several buckets in a step, which the device does not choose by itself."""


def assignment_of(selection: Selection, processors: int, seed: int) -> Assignment:
    """The policy of `selection`: for so many `processors` (LAZY), with the random numbers of `seed` (RANDOM)."""
    match selection:
        case Selection.MOST_FULL:
            return Fullest()
        case Selection.NEXT:
            return InTurn()
        case Selection.RANDOM:
            return Drawn(seed)
        case Selection.ALL:
            return Every()
        case Selection.LAZY:
            return Lazy(processors)
        case Selection.BALANCED:
            return Balanced()
    raise ValueError(f"there is no policy for the selection {selection!r}: add one here and in `policy.py`")
