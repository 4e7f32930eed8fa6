"""The report of a render on a cluster (docs/statistics.md)."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ...film import Film
from ...measure.statistics import ENGINE, versions
from ...scene.description import Scene
from ...scene.notice import by_weight, described
from ...settings.settings import RenderSettings
from ...wavefront.render.summary import adaptive_summary, complaints, error_summary
from ..keeping import ClusterKeeper
from ..under_way import UnderWay


def cluster_statistics(
    film: Film, scene: Scene, settings: RenderSettings, keeper: ClusterKeeper, under_way: UnderWay
) -> dict[str, Any]:
    """The report: what is known of renders on a cluster, and who rendered which samples (docs/statistics.md)."""
    shares = sorted(keeper.shares, key=lambda each: (each["first"], each["region"]))
    rays = {kind: sum(each["rays"][kind] for each in shares) for kind in ("camera", "bounce", "shadow", "total")}
    render, seconds = under_way.render, under_way.parts.record()
    rounds = render.rounds
    devices = {(each["worker"], each["device"]["alias"]): each["device"] for each in shares}
    warnings = dict.fromkeys(text for each in shares for text in each["warnings"])
    invalid = keeper.film.progress.invalid_samples if keeper.film else 0
    return {
        "engine": ENGINE,
        "versions": versions(),
        "device": shares[0]["device"] if shares else None,
        "devices": [*devices.values()],
        "settings": asdict(settings),
        "frame": {"width": film.width, "height": film.height, "region": [*film.region], "passes": [*film.pass_names]},
        "seconds": seconds,
        "samples": film.sample_total,
        "rays": rays,
        "rays_per_second": round(rays["total"] / seconds["render"]) if seconds["render"] else 0,
        "memory_peak": {of: max((each["memory_peak"][of] for each in shares), default=0) for of in ("host", "device")},
        "complete": film.complete,
        "stopped_by": rounds.policy.stopped_by,
        "samples_per_pixel": keeper.end - keeper.first,
        "error": error_summary(rounds.policy, rounds.error, rounds.error_samples) if film.halves else None,
        "adaptive": rounds.active and adaptive_summary(rounds.active, rounds.policy, film.sample_total),
        "invalid_samples": invalid,
        "warnings": [
            *map(str, scene.warnings),
            *warnings,
            *keeper.warnings,
            *complaints(rounds.policy, film, rounds.error_samples),
        ],
        "missing": [described(notice) for notice in by_weight(scene.warnings)],
        "cluster": {
            "shares": [
                {name: each[name] for name in ("first", "end", "region", "worker", "seconds", "seconds_rendering")}
                | {"device": each["device"]["name"]}
                for each in shares
            ],
            "tasks_again": render.tasks_again.count,
            "events": render.events.all,
            "events_left_out": render.events.left_out,
        },
    }
