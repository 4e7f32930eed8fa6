"""What the workers of a render did, for its statistics."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

from ..bvh.build import BuiltTree
from ..bvh.node import Layout
from ..report.counters import CounterTotals, TreeBytes
from .device_scene import DeviceScene
from .integrator import TileIntegrator
from .sort_policy import merged_reports


def ray_totals(integrators: Sequence[TileIntegrator]) -> dict[str, int]:
    """Rays traced, by kind."""
    return {
        "camera": sum(each.rays.camera for each in integrators),
        "bounce": sum(each.rays.bounced for each in integrators),
        "shadow": sum(each.rays.shadow for each in integrators),
    }


def workers_summary(integrators: Sequence[TileIntegrator], scene: DeviceScene | None, hardware: dict[str, Any]) -> dict[str, Any]:
    """The parts of the statistics that tell of tracing; `scene` is None where nothing was begun, `hardware` what the processor counted."""
    built = scene.built if scene else None
    own = isinstance(built, BuiltTree)
    counted = [each for each in (integrator.counted() for integrator in integrators) if each]
    totals = functools.reduce(CounterTotals.merge, counted) if counted else None
    reports = [report for report in (integrator.order_report() for integrator in integrators) if report]
    return {
        "schedule": {"workers": len(integrators), "ray_count": sum(each.path_count for each in integrators)},
        "tree": built.statistics if own else None,
        "ray_sort": merged_reports(reports),
        "counters": totals.report(tree_bytes(built.layout) if own else None, hardware) if totals else None,
    }


def tree_bytes(layout: Layout) -> TreeBytes:
    """What visits to a tree of this layout read."""
    triangles = 8 if layout is Layout.BOXES else 1
    return TreeBytes(4 * layout.node_words, 4 * layout.triangle_words // triangles)
