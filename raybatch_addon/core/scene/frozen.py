"""Arrays that nobody changes: what is known of one stays true, and one that is the same object holds the same numbers.

Whoever makes a scene may freeze its arrays. Then what follows from them is computed once and not for every render.
Other arrays work as well: they are looked at anew each time.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np

Fact = TypeVar("Fact")

# By identity of the arrays and what computes the fact: the arrays, as long as they live, and the fact
_facts: dict[tuple[tuple[int, ...], Callable], tuple[tuple[weakref.ref[np.ndarray], ...], Any]] = {}


def freeze(array: np.ndarray) -> np.ndarray:
    """`array`, which cannot be written any more, nor can what it is a view of."""
    part: np.ndarray | None = array
    while isinstance(part, np.ndarray):
        part.flags.writeable = False
        part = part.base
    return array


def is_frozen(array: np.ndarray) -> bool:
    """Whether neither `array` nor what it is a view of can be written."""
    part: np.ndarray | None = array
    while isinstance(part, np.ndarray):
        if part.flags.writeable:
            return False
        part = part.base
    return part is None  # memory of others may change


def fact(array: np.ndarray, compute: Callable[..., Fact], *others: np.ndarray) -> Fact:
    """`compute(array, *others)`, computed once for frozen arrays. `compute` is a function of a module: it is a key."""
    arrays = (array, *others)
    if not all(map(is_frozen, arrays)):
        return compute(*arrays)
    key = (tuple(map(id, arrays)), compute)
    known = _facts.get(key)
    if known is None or any(reference() is not each for reference, each in zip(known[0], arrays, strict=True)):
        references = tuple(weakref.ref(each, lambda gone: _forget(key, gone)) for each in arrays)
        known = _facts[key] = references, compute(*arrays)
    return known[1]


def _forget(key: tuple[tuple[int, ...], Callable], gone: weakref.ref) -> None:
    known = _facts.get(key)
    if known is not None and any(each is gone for each in known[0]):  # not other arrays' in the same places
        del _facts[key]


class Same:
    """Remembers arrays and plain values, to find whether others are the same. It keeps no array alive."""

    def __init__(self, arrays: Iterable[np.ndarray | None], values: object) -> None:
        """`values` are compared by `==`."""
        self._values = values
        self._references = [None if each is None else weakref.ref(each) for each in arrays]

    def holds(self, arrays: Iterable[np.ndarray | None], values: object) -> bool:
        """Whether `values` are equal and `arrays` are the same objects, all of them frozen."""
        given = list(arrays)
        return (
            len(given) == len(self._references)
            and values == self._values
            and all(map(_is_same, self._references, given))
        )


def _is_same(reference: weakref.ref[np.ndarray] | None, array: np.ndarray | None) -> bool:
    if reference is None or array is None:
        return reference is None and array is None
    return reference() is array and is_frozen(array)
