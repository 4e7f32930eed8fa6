"""The common part of studies of error against time: rows with points, their table and their plot."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from raybatch_addon.core.convergence.errors import known
from raybatch_addon.core.convergence.points import ErrorPoint, fit_slope, time_to
from studies.pages import device_title, number, table
from studies.study import Report, Row


def variants(report: Report, scene: str) -> list[str]:
    """Names of what is compared, in their order."""
    return list(dict.fromkeys(row["variant"] for row in report["rows"] if row["scene"] == scene and row.get("points")))


def scenes_of(report: Report) -> list[str]:
    """Names of the scenes, in their order."""
    return list(dict.fromkeys(row["scene"] for row in report["rows"]))


def runs(report: Report, scene: str, variant: str) -> list[Row]:
    """Rows with points."""
    return [row for row in report["rows"] if row["scene"] == scene and row["variant"] == variant and row.get("points")]


def points_of(row: Row) -> list[ErrorPoint]:
    """The points of a row, as far as fits need them."""
    floor = row["floor"]
    return [
        ErrorPoint(
            seconds=p["seconds"],
            seconds_total=p["seconds"],
            rays={},
            samples=p["samples"],
            rmse=p["rmse"],
            relmse=p["relmse"],
            rmse_spread=p["spread"],
            floor_rmse=floor["rmse"],
            floor_relmse=floor["relmse"],
        )
        for p in row["points"]
    ]


def slope_of(points: Sequence[ErrorPoint]) -> dict[str, Any] | None:
    """What a row keeps of the line through its points; None where there is none."""
    fitted = fit_slope(points)
    if fitted is None:
        return None
    return {
        "slope": fitted.slope,
        "spread": known(fitted.spread),
        "flattens": fitted.flattens,
        "last": fitted.last_slope,
        "says": fitted.says,
    }


def judge_anew(rows: Sequence[Row]) -> bool:
    """Bring the words that rows keep of their slopes to those that `fit_slope` has now for their points, in place;
    returns whether any changed. Figures stay as they are: they follow from the points alone.
    """
    changed = False
    for row in rows:
        if row.get("slope") and row.get("points"):
            fitted = fit_slope(points_of(row))
            assert fitted is not None  # it was when the row was written
            words = {"flattens": fitted.flattens, "says": fitted.says}
            changed |= words != {name: row["slope"][name] for name in words}
            row["slope"] |= words
    return changed


def median(values: Sequence[float | None]) -> float | None:
    """Median of those that are there; None where no half of them is."""
    there = [value for value in values if value is not None]
    return statistics.median(there) if 2 * len(there) > len(values) else None


def mean_curve(rows: Sequence[Row]) -> list[ErrorPoint]:
    """The mean of several runs: at each sample count mean squared errors and seconds are averaged."""
    curves = [points_of(row) for row in rows]
    mean = []
    for points in zip(*curves, strict=True):
        reported = {name: statistics.mean(getattr(p, name) for p in points) for name in ("seconds", "relmse")}
        rmse = math.sqrt(statistics.mean(p.rmse**2 for p in points))
        mean.append(replace(points[0], **reported, rmse=rmse))
    return mean


def seconds_to(rows: Sequence[Row], target: float) -> tuple[float, bool] | None:
    """Seconds to a relMSE in the mean over runs, and whether that lies beyond what was rendered; None: never, as it
    looks.
    """
    # what lies beyond follows from theory where it can: few runs do not show the slope of an error that is rarely found
    slope = (
        -0.5
        if rows[0].get("sequence") == "INDEPENDENT"
        else fit_slope([point for row in rows for point in points_of(row)])
    )
    return time_to(mean_curve(rows), target, slope)


def curves_table(reports: dict[str, Report], name: str) -> str:
    """Slopes, and the time to the same error (~: extrapolated), by scene and variant; `name` heads the variants'
    column.
    """
    rows = []
    for report in reports.values():
        for scene in scenes_of(report):
            if not variants(report, scene):
                continue
            target = mean_curve(runs(report, scene, variants(report, scene)[0]))[-1].relmse
            base = None
            for variant in variants(report, scene):
                mine = runs(report, scene, variant)
                slopes = [row["slope"]["slope"] for row in mine if row["slope"]]
                spread = f" ± {statistics.stdev(slopes):.2f}" if len(slopes) > 1 else ""
                found = seconds_to(mine, target)
                seconds, beyond = found or (None, False)
                base = base or seconds
                last = mine[0]["points"][-1]
                flat = sum(bool(row["slope"] and row["slope"]["flattens"]) for row in mine)
                rate = statistics.median(row["points"][-1]["samples"] / row["points"][-1]["seconds"] for row in mine)
                slope = (
                    f"{statistics.median(slopes):.2f}{spread}" + (f" ({flat} of {len(mine)} flatten)" if flat else "")
                    if slopes
                    else ""
                )
                rows.append(
                    [
                        device_title(report),
                        scene,
                        variant,
                        last["samples"],
                        number(mean_curve(mine)[-1].relmse),
                        slope,
                        number(rate),
                        number(target),
                        number(seconds, 3, beyond) if seconds is not None else "not to be told",
                        number(base / seconds) if base and seconds else "",
                    ]
                )
    heads = [
        "device",
        "scene",
        name,
        "samples",
        "relMSE then",
        "slope of RMSE",
        "samples/s",
        "relMSE asked for",
        "seconds to it",
        "efficiency",
    ]
    return table(heads, rows)


def draw_curves(reports: dict[str, Report], folder: Path, file: str, against: Sequence[str] = ("seconds",)) -> None:
    """A panel a scene and device: RMSE of every run, log-log, each variant in one colour."""
    from converging.ticks import plain_ticks

    from studies.plots import COLORS, LINES, legend, panels, save

    wanted = [
        (report, scene, x)
        for x in against
        for report in reports.values()
        for scene in scenes_of(report)
        if variants(report, scene)
    ]
    figure, axes = panels(len(wanted))
    names = list(dict.fromkeys(name for report, scene, _ in wanted for name in variants(report, scene)))
    for axis, (report, scene, x) in zip(axes, wanted, strict=True):
        for variant in variants(report, scene):
            again, place = divmod(names.index(variant), len(COLORS))
            color, line = COLORS[place], LINES[again % len(LINES)]
            for index, row in enumerate(runs(report, scene, variant)):
                points = [(p[x], p["rmse"]) for p in row["points"] if p[x] > 0]
                label = variant if index == 0 else None
                drawn: dict[str, Any] = {
                    "color": color,
                    "markersize": 2.5,
                    "linewidth": 0.9,
                    "alpha": 0.8,
                    "label": label,
                }
                axis.plot(*zip(*points, strict=True), f"o{line}", **drawn)
        _guide(
            axis,
            [
                (p[x], p["rmse"])
                for row in runs(report, scene, variants(report, scene)[0])
                for p in row["points"]
                if p[x] > 0
            ],
        )
        floor = median([row["floor"]["rmse"] for row in report["rows"] if row["scene"] == scene and row.get("floor")])
        if floor:
            axis.axhline(floor, color="black", linewidth=0.6, linestyle=":", label="noise of the reference")
        x_label = "samples of a pixel" if x == "samples" else "seconds of rendering"
        axis.set(xscale="log", yscale="log", xlabel=x_label, ylabel="RMSE", title=f"{scene}, {device_title(report)}")
        plain_ticks(axis.xaxis, 0.15)
        plain_ticks(axis.yaxis, 0.08)
    legend(figure, axes)
    save(figure, folder, file)


def _guide(axis, points: Sequence[tuple[float, float]]) -> None:
    """A line of slope -0.5 above the first curve."""
    if not points:
        return
    low, high = min(x for x, _ in points), max(x for x, _ in points)
    top = 1.6 * max(y for _, y in points)
    axis.plot(
        [low, high],
        [top, top * math.sqrt(low / high)],
        color="#999999",
        linewidth=0.8,
        linestyle="--",
        label="slope -0.5",
    )


def cases_of(make: Callable, scenes: Sequence[str], names: Sequence[str]) -> list:
    """A case for each scene and variant; variants of a scene take turns."""
    return [make(f"{scene}: {name}", scene, {"scene": scene, "variant": name}) for scene in scenes for name in names]
