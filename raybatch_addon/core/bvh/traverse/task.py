"""The tasks of rays that wait at treelets (`Treelets` and `TopProgress` in `tree.py`)."""

from __future__ import annotations

from enum import Enum


class VisitTask(Enum):
    """One launch over a list of rays. A ray's *location* is `NEW`, `DONE`, or the treelet at which it waits; or where a
    task says so, the queue that it goes to (`VisitOptions.writes_queues`).
    """

    TOP = "top"
    """New rays begin at the root, others go on behind the treelet that they wait at, until they come to one or are
    done.
    """
    TREELET = "treelet"
    """Rays visit the treelet that they wait at, whole, and stay there; any-hit rays that hit something are done."""
    GO_ON = "go on"
    """New rays begin, others enter the treelet that they wait at, and then go on through all that is there, until they
    come to a treelet that is not, or are done."""


def task_defines(task: VisitTask) -> dict[str, int]:
    """Macros for native code: all tasks by name, and TASK."""
    numbers = {each.name: number for number, each in enumerate(VisitTask)}
    return {**numbers, "TASK": numbers[task.name]}
