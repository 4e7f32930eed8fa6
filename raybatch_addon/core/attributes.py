"""Many attributes of an object, read with one call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any


def attributes_of(names: Sequence[str]) -> Callable[[Any], tuple]:
    """What reads all attributes `names` of an object, as a tuple."""
    if len(names) < 2:  # of one alone `attrgetter` makes no tuple
        return lambda value: tuple(getattr(value, name) for name in names)
    return attrgetter(*names)
