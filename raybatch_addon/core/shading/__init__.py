"""Shading: what a surface, a light or a camera does to a ray."""

from ..device import declared  # noqa: F401 - before anything is declared: declarations wait
