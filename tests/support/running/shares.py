"""Shares of parameters that the plain run of the tests has; a thorough run has all of them, and so has one on a GPU."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from tests.support.under_test import DEVICE


def each_of(number: int, parameters: Iterable) -> list:
    """`parameters` of `pytest.mark.parametrize`: each `number`-th is run always, the others where it is thorough."""
    return [
        pytest.param(*(each if isinstance(each, tuple) else (each,)), marks=marks_of(i % number == 0))
        for i, each in enumerate(parameters)
    ]


def thorough_but(kept: Iterable, parameters: Iterable) -> list:
    """`parameters`: those in `kept` are run always, the others where it is thorough."""
    kept, parameters = list(kept), list(parameters)
    assert set(kept) <= set(parameters), f"no parameter is called {sorted(set(kept) - set(parameters))}"
    return [pytest.param(each, marks=marks_of(each in kept)) for each in parameters]


def pairs_of(first: Iterable, second: Iterable) -> list:
    """All pairs of `first` and `second`, as parameters with names: those that have each value of both at least once are
    run always, the others where it is thorough.

    Both are of (name, value).
    """
    first, second = list(first), list(second)
    return [
        pytest.param(one, other, id=f"{name}-{other_name}", marks=marks_of(i % len(second) == k % len(first)))
        for i, (name, one) in enumerate(first)
        for k, (other_name, other) in enumerate(second)
    ]


def marks_of(always: bool) -> tuple:
    """Marks of a test that is run always, or else where it is thorough and on a GPU."""
    return () if always or DEVICE != "cpu" else (pytest.mark.thorough,)
