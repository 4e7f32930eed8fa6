"""Tracers under measurement: one builds its tree, takes rays in, and traces them as often as it is asked
to.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarking.rays import CapturedRays
from benchmarking.scenes import BenchmarkScene


@dataclass(frozen=True)
class Tree:
    """Cost of building."""

    build_seconds: float
    bytes: int | None  # nodes and geometry; None where the tracer does not report it


@dataclass(frozen=True)
class Timing:
    """One run over all rays."""

    seconds: float  # sorting included
    sort_seconds: float = 0.0


@dataclass(frozen=True)
class Hits:
    """Hits that a tracer found."""

    hit: np.ndarray  # bool, shape [n]
    t: np.ndarray | None  # [m], float32, shape [n], where `hit`; None for occlusion rays
    # where `hit`, of tracers that tell: the instance of the scene, the triangle of its mesh, int32, shape [n] each, and
    # the weights of the triangle's second and third corner, float32, shape [n, 2]
    instance: np.ndarray | None = None
    primitive: np.ndarray | None = None
    uv: np.ndarray | None = None


class MeasuredTracer(ABC):
    """One tracer under measurement."""

    name: str

    @abstractmethod
    def build(self, scene: BenchmarkScene) -> Tree:
        """Build the tree of `scene`; raises `UsageError` for a scene that this tracer cannot hold."""

    @abstractmethod
    def load(self, rays: CapturedRays, thread_count: int) -> None:
        """Take in the rays that the next runs trace, and cut them for `thread_count` threads."""

    @abstractmethod
    def trace(self) -> Timing:
        """Trace all of them."""

    @abstractmethod
    def hits(self) -> Hits:
        """What the last run found, in the order of the rays."""

    def work(self) -> dict[str, Any]:
        """What the loaded rays cost; None where the tracer does not count."""
        return dict.fromkeys(
            (
                "node_steps",
                "box_tests",
                "triangle_tests",
                "lanes_active",
                "treelet_visits",
                "queued",
                "bytes_copied",
                "stages",
            )
        )
