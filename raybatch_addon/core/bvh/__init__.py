"""Trees over triangles and instances: their layouts, how they are built, cut, stored and traversed."""

from ..device import declared  # noqa: F401 - before anything is declared: declarations wait
