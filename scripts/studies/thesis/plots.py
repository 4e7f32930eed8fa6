"""Plots of the study: all combinations, rays alive, sizes of queues."""

from __future__ import annotations

from pathlib import Path

from studies.pages import device_title
from studies.study import Report
from studies.thesis.cases import SCENES, STORAGES
from studies.thesis.results import COLUMNS, control_seconds, figures, key_of, most_alive, seconds_by_key


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Three plots: all combinations, rays alive, sizes of queues."""
    from converging.ticks import plain_ticks

    from studies.plots import BLUE, COLORS, RED, legend, panels, save

    theirs = figures()
    figure, axes = panels(len(reports))
    own = {key_of(row, COLUMNS["initial"]): row["seconds"] for row in theirs["initial"]["rows"]}
    for axis, report in zip(axes, reports.values(), strict=True):
        for scene, color in zip(SCENES, (BLUE, RED), strict=True):
            for storage, marker in zip(STORAGES, "o^", strict=True):
                found = {
                    p: s
                    for p, (s, _) in seconds_by_key(report, "initial").items()
                    if p[0] == scene and p[2] == storage and s
                }
                x, y = [own[p] for p in found], list(found.values())
                axis.scatter(x, y, s=18, marker=marker, color=color, alpha=0.7, label=f"{scene}, {storage}")
            control = control_seconds(report, scene)
            if control:
                axis.axhline(control, color=color, linestyle=":", label=f"{scene}, without queues")
        axis.set(
            xscale="log",
            yscale="log",
            xlabel="thesis [s]",
            ylabel="RayBatch [s]",
            title=f"{device_title(report)}: 96 combinations",
        )
        plain_ticks(axis.xaxis, 0.08)
        plain_ticks(axis.yaxis, 0.08)
    legend(figure, axes, 3)
    save(figure, folder, "thesis-initial")
    for name, label in (("ray_count", "rays alive"), ("queue_size", "rays of a block")):
        figure, axes = panels(len(SCENES))
        for axis, scene in zip(axes, SCENES, strict=True):
            sources = [("thesis", {key_of(row, COLUMNS[name]): row["seconds"] for row in theirs[name]["rows"]})]
            sources += [
                (device_title(r), {p: s for p, (s, _) in seconds_by_key(r, name).items() if s})
                for r in reports.values()
            ]
            for color, (source, found) in zip(COLORS, sources, strict=False):
                styles = {"DIRECT": "o-", "INDIRECT": "^--"} if name == "queue_size" else {"": "o-"}
                for storage, style in styles.items():
                    mine = sorted(
                        (p[-1], s) for p, s in found.items() if p[0] == scene and (not storage or p[1] == storage)
                    )
                    if mine:
                        best = min(s for p, s in found.items() if p[0] == scene)
                        label_of = source + (f", {storage}" if storage else "")
                        axis.plot(
                            [x for x, _ in mine],
                            [s / best for _, s in mine],
                            style,
                            color=color,
                            markersize=4,
                            label=label_of,
                        )
            axis.set(yscale="log", xlabel=label, title=scene)
            axis.set_xscale("log", base=2)
            for report in reports.values() if name == "ray_count" else ():
                most = most_alive(report)
                if most:
                    axis.axvline(
                        most,
                        color="black",
                        linewidth=0.8,
                        linestyle=":",
                        label=f"{device_title(report)}: no more are alive",
                    )
            plain_ticks(axis.yaxis, 0.08)
        axes[0].set_ylabel("time over the best")
        legend(figure, axes, 3)
        save(figure, folder, f"thesis-{name.replace('_', '-')}")
