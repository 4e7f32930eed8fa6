"""Shares of parameters that the plain run of the tests has; a thorough run has all of them."""

from __future__ import annotations

from collections.abc import Iterable

import pytest


def each_of(number: int, parameters: Iterable) -> list:
    """`parameters` of `pytest.mark.parametrize`: each `number`-th is run always, the others where it is thorough."""
    return [
        pytest.param(
            *(each if isinstance(each, tuple) else (each,)), marks=() if i % number == 0 else pytest.mark.thorough
        )
        for i, each in enumerate(parameters)
    ]


def thorough_but(kept: Iterable, parameters: Iterable) -> list:
    """`parameters`: those in `kept` are run always, the others where it is thorough."""
    kept = list(kept)
    return [pytest.param(each, marks=() if each in kept else pytest.mark.thorough) for each in parameters]
