"""Sums over the workers of a render, for its statistics."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import warp as wp

from ...bvh.node import Layout
from ...bvh.traverse.reference import BuiltReference
from ...convergence.halves import HalfError
from ...film import Film
from ...measure.batching import BatchingTotals
from ...measure.counters import CounterTotals, TreeBytes
from ...measure.volumes import VolumeCounts
from ...native.structs import to_numpy
from ..adaptive.active_pixels import ActivePixels
from ..integrator import TileIntegrator
from ..order.sort_policy import merged_reports
from ..scene.device_scene import DeviceScene
from ..textures.pool import TileTotals
from .resume import ResumeState
from .rounds import RoundPolicy


def ray_totals(integrators: Sequence[TileIntegrator]) -> dict[str, int]:
    """Rays traced, by kind."""
    return {
        "camera": sum(each.rays.camera for each in integrators),
        "bounce": sum(each.rays.bounced for each in integrators),
        "shadow": sum(each.rays.shadow for each in integrators),
    }


def rounds_summary(film: Film, state: ResumeState, error: dict[str, Any] | None) -> dict[str, Any]:
    """The parts of the statistics about samples: how far the render came, why it ended, and which pixels got how many;
    `error` is what is known of it.
    """
    return {
        "complete": film.complete,
        "stopped_by": state.policy.stopped_by,
        "samples_per_pixel": state.done,
        "error": error,
        "adaptive": state.active and adaptive_summary(state.active, state.policy, film.sample_total),
    }


def adaptive_summary(active: ActivePixels, policy: RoundPolicy, sample_total: int) -> dict[str, Any]:
    """What looks at the noise came to; `sample_total`: samples of all pixels together."""
    return {
        "threshold": active.threshold,
        "samples_min": policy.looks.first if policy.looks else None,
        "samples_mean": sample_total / active.stopped.size,
        "converged": 1.0 - active.share,
        "looks": active.looks,
    }


def error_summary(policy: RoundPolicy, found: HalfError | None, samples: int) -> dict[str, Any]:
    """What is known of the error of a film with halves, which was looked at after `samples` samples."""
    return {
        "relmse": found.relmse if found else None,
        "rmse": found.rmse if found else None,
        "samples": samples,
        "target": policy.error_target,
        "reached": bool(found and found.relmse <= policy.error_target > 0),
        "stopped_by": policy.stopped_by,
    }


def complaints(policy: RoundPolicy, film: Film, samples: int) -> list[str]:
    """Warnings about how the render of `film` ended, after `samples` samples."""
    if policy.stopped_by != "error" or film.passes["Combined"][..., :3].any():
        return []
    return [
        f"error_target was met by a black picture: no path of {samples} samples found any light, so that nothing is "
        "known of its error; if it should not be black, set error_target to 0 and render all samples"
    ]


def device_shares(devices: Sequence[wp.Device], integrators: Sequence[TileIntegrator]) -> list[dict[str, Any]]:
    """What each of `devices` did: paths that came to their end, and seconds in which its workers, in the mean, were at
    a tile.
    """
    shares = []
    for device in devices:
        its = [each for each in integrators if each.device == device]
        seconds = sum(each.seconds_working for each in its) / max(len(its), 1)
        shares.append({"paths": sum(each.items_done for each in its), "seconds_working": round(seconds, 6)})
    return shares


def batching_totals(integrators: Sequence[TileIntegrator]) -> BatchingTotals | None:
    """What the workers' rays waited for; None where no ray waits."""
    found = [totals for totals in (integrator.batching_totals() for integrator in integrators) if totals]
    return functools.reduce(BatchingTotals.merge, found) if found else None


def tile_totals(integrators: Sequence[TileIntegrator]) -> TileTotals | None:
    """What the workers fetched of images; None where all images are whole."""
    found = [each.textures.totals() for each in integrators if each.textures]
    return functools.reduce(TileTotals.merge, found) if found else None


def volume_counts(integrators: Sequence[TileIntegrator]) -> VolumeCounts | None:
    """What the workers counted in volumes; None where there are none."""
    found = [to_numpy(each.volumes.counts).sum(0).tolist() for each in integrators if each.volumes]
    return VolumeCounts(*map(sum, zip(*found, strict=True))) if found else None


def workers_summary(
    integrators: Sequence[TileIntegrator], scene: DeviceScene | None, hardware: dict[str, Any], path_bytes: int
) -> dict[str, Any]:
    """The parts of the statistics about tracing; `scene` is None where nothing was begun, `hardware` what the
    processor counted.
    """
    built = scene.built if scene else None
    own = built is not None and not isinstance(built, BuiltReference)
    counted = [each for each in (integrator.counted() for integrator in integrators) if each]
    totals = functools.reduce(CounterTotals.merge, counted) if counted else None
    reports = [report for report in (integrator.order_report() for integrator in integrators) if report]
    return {
        "schedule": {
            "workers": len(integrators),
            "ray_count": sum(each.path_count for each in integrators),
            "bytes_per_path": path_bytes,
        },
        "tree": {**built.statistics, **({"cut": scene.treelets.statistics} if scene.treelets else {})} if own else None,
        "ray_sort": merged_reports(reports),
        "counters": totals.report(tree_bytes(scene.tracing.layout) if own else None, hardware) if totals else None,
    }


def tree_bytes(layout: Layout) -> TreeBytes:
    """What visits to a tree of this layout read."""
    triangles = 8 if layout is Layout.BOXES else 1
    return TreeBytes(4 * layout.node_words, 4 * layout.triangle_words // triangles)
