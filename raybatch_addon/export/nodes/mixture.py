"""Sums of weighted closures: what a shader socket stands for."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from ...core.scene.description import Closure, ClosureKind

Color = tuple[float, float, float]
WHITE: Color = (1.0, 1.0, 1.0)
BLACK: Color = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Mixture:
    """Closures of a graph or of a part of it."""

    closures: tuple[Closure, ...] = ()
    kinds: frozenset[ClosureKind] = frozenset()  # that the nodes can have, whatever their values

    def __add__(self, other: Mixture) -> Mixture:
        return Mixture(self.closures + other.closures, self.kinds | other.kinds)

    def scaled(self, factor: float) -> Mixture:
        """All weights times `factor`."""
        return Mixture(tuple(_scaled(closure, factor) for closure in self.closures), self.kinds)

    def visible(self) -> Mixture:
        """Without the closures of weight 0."""
        return Mixture(tuple(c for c in self.closures if any(c.weight) or (c.kind == ClosureKind.METAL and c.share > 0)), self.kinds)


def _scaled(closure: Closure, factor: float) -> Closure:
    return dataclasses.replace(closure, weight=times(closure.weight, factor), share=closure.share * factor)


def times(color: Color, factor: float) -> Color:
    """`color` times a number."""
    return color[0] * factor, color[1] * factor, color[2] * factor


def saturated(value: float) -> float:
    """`value` clamped to 0..1."""
    return min(max(value, 0.0), 1.0)


def single(kind: ClosureKind, weight: Color, **values) -> Mixture:
    """One closure, which counts as its kind even when its weight is 0."""
    return Mixture((Closure(kind, weight, **values),), frozenset([kind]))
