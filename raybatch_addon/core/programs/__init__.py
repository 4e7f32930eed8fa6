"""Programs of shader graphs: how they are built, stored, and run in kernels."""

from ..device import declared  # noqa: F401 - before anything is declared: declarations wait
