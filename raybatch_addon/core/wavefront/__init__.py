"""The wavefront: rays and paths in arrays, and the loop of stages that moves them."""

from ..device import declared  # noqa: F401 - before anything is declared: declarations wait
