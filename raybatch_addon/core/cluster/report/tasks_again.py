"""How many tasks of a render on a cluster were rendered more than once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


class TasksAgain:
    """Counts them: those that the render asks for again, and those that Dask gives out again by itself, since their
    worker went while it was rendering them, or with their film.
    """

    def __init__(self) -> None:
        self._asked = 0
        self._keys: set[str] = set()  # of the futures of tasks
        self._given: set[tuple[str, float]] = set()  # of those that went with a worker, and when

    @property
    def count(self) -> int:
        """Once for each time that a task was begun again."""
        return self._asked + len(self._given)

    def know(self, future: Any) -> Any:
        """`future`, which is of a task of the render."""
        self._keys.add(future.key)
        return future

    def ask(self, instead: Iterable[Any] = ()) -> None:
        """A task is asked for again; `instead` of these futures, which nobody wants any more."""
        self._keys -= {each.key for each in instead}
        self._given = {each for each in self._given if each[0] in self._keys}
        self._asked += 1

    def give(self, found: set[tuple[str, float]]) -> None:
        """What of these keys are tasks of the render went with a worker, at these times; each time counts once."""
        self._given |= {each for each in found if each[0] in self._keys}
