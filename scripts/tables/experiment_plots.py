"""Draw the plots of docs/experiments and write the tables of traversal.md there, from docs/experiments/data: python
scripts/tables/experiment_plots.py

Needs matplotlib. `traversal-SCENE-DEVICE.json` and `batching-*.json` are reports of `scripts/benchmark.py traversal`;
`variants-*.json` are kernels that were compiled apart for the comparison; the others hold single figures. Nothing on
the page is typed in by hand between marks.
"""

from __future__ import annotations

import math
import sys
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

import matplotlib

matplotlib.use("svg")
from lib.output import write_text
from matplotlib import pyplot

from tables.experiment_data import FOLDER, NAMES, PLAIN, RAYS, REFILL, cases, load, rate_text, title
from tables.experiment_tables import (
    build_table,
    lanes_table,
    profile_table,
    renders_table,
    scenes_table,
    table,
    tracers_table,
    variants_table,
)
from tables.marked_text import with_part

PAGE = FOLDER / "traversal.md"
COLORS = {
    "off": "#0072b2",
    "off-plain": "#999999",
    "off-sorted": "#56b4e9",
    "reference": "#d55e00",
    "embree": "#d55e00",
    "embree-robust": "#e69f00",
}
BATCHING = {
    "off": ("unbatched, all in memory", "#0072b2"),
    "off-sorted": ("unbatched, sorted", "#56b4e9"),
    "auto": ("chosen by RayBatch", "#009e73"),
    "on": ("batched", "#d55e00"),
    "zero-copy-triangles": ("unbatched, triangles read from the host", "#777777"),
    "zero-copy": ("unbatched, all read from the host", "#bbbbbb"),
    "ray-order": ("pages brought in by the rays' order", "#cc79a7"),
}  # of plots about batching: name and color by tracer, in the order of bars


def save(figure: pyplot.Figure, name: str) -> None:
    """Write the plot; the same data give the same file."""
    figure.savefig(FOLDER / f"{name}.svg", bbox_inches="tight", facecolor="white", metadata={"Date": None})
    pyplot.close(figure)


def draw_tracers(reports: dict[str, dict[str, Any]], peer: str, name: str) -> None:
    """Bars of every tracer's rate over that of `peer`, a panel a scene."""
    group_count = max(len(cases(report)) for report in reports.values())
    figure, panels = pyplot.subplots(
        1, len(reports), figsize=((1.5 + 0.75 * group_count) * len(reports), 3.4), squeeze=False, sharey=True
    )
    for panel, report in zip(panels[0], reports.values(), strict=True):
        groups = cases(report)
        tracers = [each for each in NAMES if each in report["trees"] and each != peer]
        width = 0.8 / len(tracers)
        for place, tracer in enumerate(tracers):
            heights = [by_name[tracer]["mrays_per_s"] / by_name[peer]["mrays_per_s"] for by_name in groups.values()]
            at = [index + (place - (len(tracers) - 1) / 2) * width for index in range(len(groups))]
            panel.bar(at, heights, width, label=NAMES[tracer], color=COLORS[tracer])
        panel.axhline(1, color=COLORS[peer], label=NAMES[peer])
        panel.set_xticks(
            range(len(groups)), [f"{RAYS.get(rays, rays)}\n{order}" for rays, order, _ in groups], fontsize=8
        )
        panel.set_title(f"{title(report)}, {report['triangles']:,} triangles")
    panels[0][0].set_ylabel(f"rate over {NAMES[peer]}")
    figure.legend(*panels[0][0].get_legend_handles_labels(), fontsize=8, loc="center left", bbox_to_anchor=(0.91, 0.5))
    save(figure, name)


def rate(data: dict[str, Any], label: str, column: str) -> float:
    """Mrays/s of a variant."""
    return next(variant["mrays_per_s"][column] for variant in data["variants"] if variant["label"] == label)


def draw_refill(variants: dict[str, dict[str, Any]]) -> None:
    """Rate over the number of lanes that must wait; 0: plain, with one triangle a turn."""
    figure, panels = pyplot.subplots(1, len(variants), figsize=(5.4 * len(variants), 3.4), squeeze=False)
    steps = {"plain": "plain, one triangle a turn"} | {
        str(lanes): f"refill {lanes}" for lanes in (1, 2, 4, 6, 8, 16, 32)
    }
    for panel, data in zip(panels[0], variants.values(), strict=True):
        for column in data["variants"][0]["mrays_per_s"]:
            rays, order = column.split()
            if order != "sorted":
                panel.plot(
                    list(steps),
                    [rate(data, label, column) for label in steps.values()],
                    "o-" if order == "natural" else "s--",
                    markersize=4,
                    color={"primary": "#009e73", "bounce1": "#0072b2", "bounce4": "#d55e00"}[rays],
                    label=f"{RAYS[rays]}, {order}",
                )
        panel.set_title(f"{title(data)}, {data['triangles']:,} triangles")
        panel.set_xlabel("lanes that wait before a warp takes new rays")
        panel.set_ylim(bottom=0)
    panels[0][0].set_ylabel("Mrays/s")
    figure.legend(*panels[0][0].get_legend_handles_labels(), fontsize=8, loc="center left", bbox_to_anchor=(0.91, 0.5))
    save(figure, "cuda-refill")


def draw_lanes(variants: dict[str, dict[str, Any]]) -> None:
    """Lanes at work, plainly and with refill."""
    figure, panels = pyplot.subplots(1, len(variants), figsize=(8 * len(variants), 3.2), squeeze=False, sharey=True)
    bars = [
        ("lanes_alive", 1.0, "with a ray"),
        ("lanes_visiting", 0.7, "visiting a node"),
        ("lanes_testing", 0.4, "testing a triangle"),
    ]
    for panel, data in zip(panels[0], variants.values(), strict=True):
        columns = list(dict.fromkeys((counted["rays"], counted["order"]) for counted in data["counters"]))
        for side, (variant, color) in enumerate(((PLAIN, "#777777"), (REFILL, "#0072b2"))):
            for what, (key, alpha, words) in enumerate(bars):
                counted = {
                    (each["rays"], each["order"]): each[key] for each in data["counters"] if each["variant"] == variant
                }
                at = [index + (3 * side + what - 2.5) * 0.14 for index in range(len(columns))]
                panel.bar(
                    at,
                    [counted[column] for column in columns],
                    0.13,
                    color=color,
                    alpha=alpha,
                    label=f"{'plain' if side == 0 else 'refill'}: {words}",
                )
        panel.set_xticks(range(len(columns)), [f"{RAYS[rays]}\n{order}" for rays, order in columns], fontsize=8)
        panel.set_title(title(data))
        panel.set_ylim(0, 32)
    panels[0][0].set_ylabel("lanes of 32")
    figure.legend(*panels[0][0].get_legend_handles_labels(), fontsize=8, loc="center left", bbox_to_anchor=(0.91, 0.5))
    save(figure, "cuda-lanes")


def draw_bars(panel: pyplot.Axes, groups: dict[str, dict[str, dict[str, Any]]], gap: float = 0.8) -> None:
    """Bars of Mrays/s by tracer, a group for each name; the tracers that a group lacks take no room."""
    width = gap / max(len(by_name) for by_name in groups.values())
    for index, by_name in enumerate(groups.values()):
        tracers = [tracer for tracer in BATCHING if tracer in by_name]
        for place, tracer in enumerate(tracers):
            words, color = BATCHING[tracer]
            bar = panel.bar(
                index + (place - (len(tracers) - 1) / 2) * width,
                by_name[tracer]["mrays_per_s"],
                width,
                color=color,
                label=words,
            )
            panel.bar_label(bar, [rate_text(by_name[tracer]["mrays_per_s"])], fontsize=7, padding=1)
    panel.set_xticks(range(len(groups)), list(groups), fontsize=8)
    panel.set_xlim(-0.6, len(groups) - 0.4)


def legend(figure: pyplot.Figure) -> None:
    """One legend at the right of all panels, each tracer once."""
    found = {
        words: handle for panel in figure.axes for handle, words in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    order = [words for words, _ in BATCHING.values() if words in found]
    figure.legend([found[words] for words in order], order, fontsize=8, loc="center left", bbox_to_anchor=(0.91, 0.5))


def draw_batching(reports: dict[str, dict[str, Any]]) -> None:
    """Rates of batched rays: with geometry beyond the memory, on CUDA and on the CPU, and with all of it in memory."""
    beyond: list[tuple[str, dict[str, dict[str, dict[str, Any]]]]] = []
    for device, pattern in (("CUDA", "batching-cuda-*-rays"), ("CPU", "batching-cpu-*-disk")):
        found = [report for name, report in reports.items() if fnmatch(name, pattern)]
        groups = {}
        for report in found:
            for (rays, order, _), by_name in cases(report).items():
                count = next(iter(by_name.values()))["ray_count"]
                groups[f"{count / 1e6:.0f}M rays\n{RAYS[rays]}, {order}"] = by_name
        held = max(
            result["resident_peak"] for report in found for result in report["results"] if result["tracer"] == "on"
        )
        beyond.append(
            (f"{device}, {found[0]['triangles'] / 1e6:.0f}M triangles,\nbatched in {held / 1e9:.1f} GB", groups)
        )
    figure, panels = pyplot.subplots(
        1, len(beyond), figsize=(9.5, 3.4), width_ratios=[len(groups) for _, groups in beyond]
    )
    for panel, (words, groups) in zip(panels, beyond, strict=True):
        draw_bars(panel, groups)
        panel.set_yscale("log")
        rates = [math.log10(result["mrays_per_s"]) for by_name in groups.values() for result in by_name.values()]
        panel.set_ylim(
            10 ** math.floor(min(rates)), 10 ** math.ceil(max(rates))
        )  # whole decades: no labels between them
        panel.set_title(words)
    panels[0].set_ylabel("Mrays/s, logarithmic")
    legend(figure)
    save(figure, "batching-beyond-memory")
    report = reports["batching-cuda-in-memory"]
    figure, panel = pyplot.subplots(figsize=(7.5, 3.4))
    draw_bars(panel, {f"{RAYS[rays]}\n{order}": by_name for (rays, order, _), by_name in cases(report).items()})
    panel.set(ylabel="Mrays/s", title=f"CUDA, {report['triangles'] / 1e6:.0f}M triangles")
    legend(figure)
    save(figure, "batching-in-memory")


def draw_waves(sorting: dict[str, Any]) -> None:
    """What sorting gains by the length of the list."""
    waves = sorting["waves"]
    figure, panel = pyplot.subplots(figsize=(4.4, 2.8))
    panel.plot(list(waves["gain_percent"]), list(waves["gain_percent"].values()), "o-", color="#0072b2")
    panel.set(
        xlabel="rays in a list", ylabel="gain of sorting [%]", ylim=(0, None), title=f"{waves['scene']}, bounce 4, CPU"
    )
    save(figure, "cpu-waves")


def main() -> None:
    matplotlib.rcParams.update({"svg.hashsalt": "experiments", "axes.spines.top": False, "axes.spines.right": False})
    cpu, cuda, variants = load("traversal-*-cpu.json"), load("traversal-*-cuda.json"), load("variants-*-cuda.json")
    sorting, build, trials = (load(f"{name}.json")[name] for name in ("sorting", "build", "cpu-trials"))
    draw_tracers(cpu, "embree", "cpu-tracers")
    draw_tracers(cuda, "reference", "cuda-tracers")
    draw_refill(variants)
    draw_lanes(variants)
    draw_waves(sorting)
    draw_batching(load("batching-*.json"))
    parts = {
        "cpu": tracers_table(cpu),
        "cuda": tracers_table(cuda),
        "lanes": lanes_table(variants),
        "profile": profile_table(load("profile-*.json")),
        "cpu scenes": scenes_table(load("cpu-scenes.json")["cpu-scenes"]),
        "build": build_table(build),
        "renders": renders_table(sorting),
        "kept": table(["what", "gain"], trials["kept"]),
        "lost": table(["what", "effect"], trials["lost"]),
    }
    parts |= {name: variants_table(data) for name, data in variants.items()}
    text = PAGE.read_text(encoding="utf-8")
    for name, part in parts.items():
        text = with_part(text, f"<!-- {name} -->", "<!-- end -->", part, PAGE)
    write_text(PAGE, text)


if __name__ == "__main__":
    main()
