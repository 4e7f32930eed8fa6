"""Which programs give the same at all points of an object."""

from __future__ import annotations

import dis
import functools
from collections.abc import Callable, Iterable

from .op import op_named, op_numbers

# Ops that read of the point in which object it is, and at which time
_OF_OBJECT = frozenset(("object_info", "object_location", "object_attribute"))


def is_uniform(ops: Iterable[str]) -> bool:
    """Whether a program of `ops` gives the same wherever in an object it runs, for one ray."""
    return all(map(_is_uniform, ops))


@functools.cache
def _is_uniform(name: str) -> bool:
    op_numbers()  # ops are registered
    return name in _OF_OBJECT or not _reads_point(op_named(name).function.func)


def _reads_point(function: Callable) -> bool:
    """Whether the function of an op makes use of its `point`, the fourth of its arguments."""
    point = function.__code__.co_varnames[3]
    for step in dis.get_instructions(function):
        names = step.argval if isinstance(step.argval, tuple) else (step.argval,)  # two variables in one instruction
        if point in names:
            return True
    return False
