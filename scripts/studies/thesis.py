"""The thesis's three tables on our tracer: its 96 combinations of parameters, its numbers of rays alive, its sizes of queues."""

from __future__ import annotations

import itertools
import json
import math
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from raybatch_addon.core.presets import preset_settings
from raybatch_addon.core.settings import RenderSettings

from . import scenes
from .bench import Bench, whole_seconds, with_frame
from .pages import device_title, films_line, machine, number, table
from .rows import differing_films, first_rows
from .study import Case, Options, Report, Row, Study

FIGURES = Path(__file__).resolve().parents[2] / "docs/studies/data/thesis-figures.json"
SCENES = ("dragon", "sponza")
ORDERS, STORAGES = ("FRAME_FIRST", "PIXEL_FIRST"), ("DIRECT", "INDIRECT")
TREELET_SIZES, RAY_COUNTS = (200, 800, 1600, 2000), (1024, 10240, 1048576)
# Of its appendices D and E
MANY_RAY_COUNTS, QUEUE_SIZES = tuple(2**k for k in range(8, 22)), (32, 64, 128, 256, 512, 1024, 2048)
SAMPLES, BOUNCES = 2, 7  # SPP and MAXDEPTH
# What all runs of a table had, as far as the thesis tells it: (sample_order, treelet_size, ray_count, queue_size)
SWEEP = {"sample_order": "FRAME_FIRST", "treelet_size": 800, "ray_count": 1048576, "queue_size": 64}
PARAMETERS = ("sample_order", "ray_storage", "treelet_size", "ray_count", "queue_size")


def settings_of(changes: dict[str, Any], samples: int = SAMPLES) -> RenderSettings:
    """Our settings for parameters of the thesis: those of the preset THESIS on all warps, with `changes`.

    MIN_TREELETSIZE, which the thesis does not tell, is 1, so that TREELETSIZE alone decides: with the preset's (as large as TREELETSIZE)
    most of the 96 would be of one treelet, since our nodes hold about six of the thesis's, and so there are fewer of them.
    """
    values = {**preset_settings("THESIS"), "warp_count": 0, "treelet_size_min": 1, **changes}
    # no Russian roulette: the thesis does not tell of any
    return RenderSettings(
        sample_count=samples, bounce_max=BOUNCES, roulette_bounce=BOUNCES + 1, pixel_filter="BOX", sample_sequence="INDEPENDENT", **values
    )


def initial_cases() -> list[Case]:
    """Its 96 combinations (table 4.2)."""
    found = []
    for scene, treelets, rays, storage, order in itertools.product(SCENES, TREELET_SIZES, RAY_COUNTS, STORAGES, ORDERS):
        what = {"table": "initial", "scene": scene, "sample_order": order, "ray_storage": storage, "treelet_size": treelets, "ray_count": rays}
        found.append(Case(f"initial {scene} {order} {storage} {treelets} {rays}", f"initial {scene} {treelets}", what))
    return found


def cases(options: Options) -> list[Case]:
    """Those of the three tables, each group beside the same render without queues, and on one warp where there are warps."""
    found = initial_cases()
    for scene in SCENES:
        for rays in MANY_RAY_COUNTS:
            what = {"table": "ray_count", "scene": scene, "ray_storage": "DIRECT", **SWEEP, "ray_count": rays}
            found.append(Case(f"ray_count {scene} {rays}", f"ray_count {scene}", what))
        for size, storage in itertools.product(QUEUE_SIZES, STORAGES):
            what = {"table": "queue_size", "scene": scene, "ray_storage": storage, **SWEEP, "queue_size": size}
            found.append(Case(f"queue_size {scene} {storage} {size}", f"queue_size {scene}", what))
    for group, scene in dict.fromkeys((case.group, case.what["scene"]) for case in found):
        found.append(Case(f"control of {group}", group, {"table": "control", "scene": scene}))
    if options.is_cuda:
        for scene, order, treelets, rays in (("dragon", "FRAME_FIRST", 800, 10240), ("sponza", "PIXEL_FIRST", 200, 1024)):
            what = {"table": "one_warp", "scene": scene, "sample_order": order, "ray_storage": "DIRECT", "treelet_size": treelets, "ray_count": rays}
            found.append(Case(f"one_warp {scene}", f"one_warp {scene}", what))
    return found


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """One render of both samples."""
    options, what = bench.options, case.what
    edge = 1280 if options.is_cuda else options.pick(80, 320)
    scene = bench.scene(what["scene"], lambda: scenes.under_a_plane(what["scene"], options, 64))
    if what["table"] == "control":
        settings = settings_of({}).replace(**preset_settings("UNBATCHED"))
    else:
        settings = settings_of({name: what[name] for name in PARAMETERS if name in what})
    if what["table"] == "one_warp":
        settings = settings.replace(warp_count=1)
    cap = options.pick(1.5, 20.0) if options.is_cuda else options.pick(2.0, 8.0)
    warm = (what["scene"], settings.batching, settings.ray_storage, settings.treelet_size)
    return {"edge": edge, **bench.timed(with_frame(scene, edge, edge), settings, warm, cap)}


# --- tables


def figures() -> dict[str, Any]:
    """The thesis's own, by table."""
    return json.loads(FIGURES.read_text(encoding="utf-8"))["tables"]


def place_of(row: Row, names: Sequence[str]) -> tuple:
    """Where a row stands in a table."""
    return tuple(row[name] for name in names)


KEYS = {
    "initial": ("scene", "sample_order", "ray_storage", "treelet_size", "ray_count"),
    "ray_count": ("scene", "ray_count"),
    "queue_size": ("scene", "ray_storage", "queue_size"),
}


def seconds_by_place(report: Report, name: str) -> dict[tuple, tuple[float | None, bool]]:
    """Median seconds of a whole render, and whether it is an estimate, by place in a table of the thesis."""
    found: dict[tuple, list[tuple[float, bool]]] = {}
    for row in report["rows"]:
        if row["table"] == name:
            seconds = whole_seconds(row)
            place = found.setdefault(place_of(row, KEYS[name]), [])
            if seconds is not None:
                place.append((seconds, not row["complete"]))
    return {place: (statistics.median(s for s, _ in rows), any(e for _, e in rows)) if rows else (None, True) for place, rows in found.items()}


def control_seconds(report: Report, scene: str) -> float | None:
    """Median of the control over all groups."""
    found = [row["seconds"] for row in report["rows"] if row["table"] == "control" and row["scene"] == scene and row["complete"]]
    return statistics.median(found) if found else None


def fragment(reports: dict[str, Report]) -> str:
    """Summary, effects, and all three tables."""
    theirs = figures()
    parts = [f"- {machine(report)}" for report in reports.values()]
    wrong = [each for report in reports.values() for each in differing_films(report["rows"], ("scene", "edge"))]
    whole = sum(bool(row["complete"]) for report in reports.values() for row in report["rows"])
    parts += [f"- {films_line(wrong, whole)}", *_control_lines(reports), *_alive_lines(reports), ""]
    parts += ["### In short", "", _summary_table(reports, theirs), "", _shape_table(reports), ""]
    parts += ["### What each parameter does", "", _effects_table(reports, theirs), "", "![All combinations](thesis-initial.svg)", ""]
    for name, title in (("ray_count", "Rays alive (appendix D)"), ("queue_size", "Size of a queue's block (appendix E)")):
        parts += [f"### {title}", "", f"![{title}](thesis-{name.replace('_', '-')}.svg)", "", _full_table(name, reports, theirs), ""]
    parts += ["### All 96 combinations (appendix C)", "", _full_table("initial", reports, theirs)]
    return "\n".join(parts)


def most_alive(report: Report) -> int | None:
    """How many rays were alive at most, where some cases asked for more than there are in the tiles at work."""
    told = [(row["ray_count"], row["rays_alive"]) for row in report["rows"] if row["table"] == "ray_count" and row.get("rays_alive")]
    return max(alive for _, alive in told) if any(alive < asked for asked, alive in told) else None


def _alive_lines(reports: dict[str, Report]) -> list[str]:
    """Where cases asked for more rays than there were."""
    found = {device_title(report): most_alive(report) for report in reports.values()}
    return [
        f"- {device}: at most {most:,} rays were alive, all that the tiles at work have; cases that asked for more repeat that one."
        for device, most in found.items() if most
    ]  # fmt: skip


def _control_lines(reports: dict[str, Report]) -> list[str]:
    """How much the machine's own speed changed meanwhile."""
    lines = []
    for report in reports.values():
        told = []
        for scene in SCENES:
            found = [row["seconds"] for row in report["rows"] if row["table"] == "control" and row["scene"] == scene and row["complete"]]
            if len(found) > 1:
                told.append(f"{number(min(found))} to {number(max(found))} s ({scene})")
        if told:
            lines.append(
                f"- {device_title(report)}: the control, which was rendered in each group of cases, took {' and '.join(told)}: so much the "
                "machine's speed changed."
            )
    return lines


def _full_table(name: str, reports: dict[str, Report], theirs: dict[str, Any]) -> str:
    ours = {kind: seconds_by_place(report, name) for kind, report in reports.items()}
    rows, listed = [], theirs[name]["rows"]
    for row in sorted(listed, key=lambda each: (each["scene"], each["seconds"])) if name == "initial" else listed:
        place = place_of(row, KEYS[name])
        rows.append([*place, f"{row['seconds']:.2f}", *(number(*_with_digits(found.get(place, (None, True)))) for found in ours.values())])
    return table([*(key.replace("_", " ") for key in KEYS[name]), "thesis [s]", *(f"{device_title(r)} [s]" for r in reports.values())], rows)


def _with_digits(found: tuple[float | None, bool]) -> tuple[float | None, int, bool]:
    return found[0], 3, found[1]


def _summary_table(reports: dict[str, Report], theirs: dict[str, Any]) -> str:
    rows = []
    for scene in SCENES:
        best = min((row for row in theirs["initial"]["rows"] if row["scene"] == scene), key=lambda row: row["seconds"])
        worst = max(row["seconds"] for row in theirs["initial"]["rows"] if row["scene"] == scene) / best["seconds"]
        rows.append([scene, "thesis, RTX 2080, one warp", _words(place_of(best, KEYS["initial"])[1:]), f"{best['seconds']:.1f}", f"{worst:.1f}", ""])
        for report in reports.values():
            ours = {p: s for p, (s, _) in seconds_by_place(report, "initial").items() if p[0] == scene and s is not None}
            if not ours:
                continue
            place = min(ours, key=ours.get)
            control = control_seconds(report, scene)
            edge = next(row["edge"] for row in report["rows"] if "edge" in row)
            slower = number(max(ours.values()) / ours[place])
            rows.append([scene, f"{device_title(report)}, {edge} x {edge}", _words(place[1:]), number(ours[place]), slower, number(control)])
            for row in report["rows"]:
                if row["table"] == "one_warp" and row["scene"] == scene and row["turn"] == 0:
                    seconds = number(whole_seconds(row), 3, not row["complete"])
                    rows.append([scene, f"{device_title(report)}, one warp", _words(place_of(row, KEYS["initial"])[1:]), seconds, "", ""])
    return table(["scene", "tracer", "best combination", "seconds", "worst over best", "without queues [s]"], rows)


def _words(place: tuple) -> str:
    return ", ".join(map(str, place))


def _shape_table(reports: dict[str, Report]) -> str:
    rows, own = [], figures()["initial"]["rows"]
    for report in reports.values():
        seen = set()
        for row in first_rows(report["rows"]).values():
            key = (row["scene"], row.get("treelet_size"))
            if row["table"] == "initial" and row.get("treelets") and key not in seen:
                seen.add(key)
                theirs = next(r["treelets"] for r in own if (r["scene"], r["treelet_size"]) == key)
                rows.append([device_title(report), *key, row["treelets"], f"{row['treelet_nodes']:.0f}", theirs])
    return table(["tree of", "scene", "treelet size", "treelets", "nodes of one, mean", "treelets of the thesis"], rows)


def _effects_table(reports: dict[str, Report], theirs: dict[str, Any]) -> str:
    """Time relative to the first value of a parameter, geometric means over all other parameters."""
    sources = [("thesis", {place_of(row, KEYS["initial"]): row["seconds"] for row in theirs["initial"]["rows"]})]
    sources += [(device_title(r), {p: s for p, (s, _) in seconds_by_place(r, "initial").items() if s is not None}) for r in reports.values()]
    rows = []
    for index, (name, values) in enumerate(zip(KEYS["initial"][1:], (ORDERS, STORAGES, TREELET_SIZES, RAY_COUNTS), strict=True), start=1):
        for value in values[1:]:
            cells = []
            for (_, found), scene in itertools.product(sources, SCENES):
                ratios = []
                for place, seconds in found.items():
                    first = place[:index] + (values[0],) + place[index + 1 :]
                    if place[0] == scene and place[index] == value and first in found:
                        ratios.append(math.log(seconds / found[first]))
                cells.append(f"{math.exp(statistics.mean(ratios)):.2f}" if ratios else "")
            rows.append([f"`{name}`", f"{value} over {values[0]}", *cells])
    return table(["parameter", "time of", *(f"{source}, {scene}" for (source, _), scene in itertools.product(sources, SCENES))], rows)


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Three plots: all combinations, rays alive, sizes of queues."""
    from converging.ticks import plain_ticks

    from .plots import BLUE, COLOURS, RED, legend, panels, save

    theirs = figures()
    figure, axes = panels(len(reports))
    own = {place_of(row, KEYS["initial"]): row["seconds"] for row in theirs["initial"]["rows"]}
    for axis, report in zip(axes, reports.values(), strict=True):
        for scene, colour in zip(SCENES, (BLUE, RED), strict=True):
            for storage, marker in zip(STORAGES, "o^", strict=True):
                found = {p: s for p, (s, _) in seconds_by_place(report, "initial").items() if p[0] == scene and p[2] == storage and s}
                x, y = [own[p] for p in found], list(found.values())
                axis.scatter(x, y, s=18, marker=marker, color=colour, alpha=0.7, label=f"{scene}, {storage}")
            control = control_seconds(report, scene)
            if control:
                axis.axhline(control, color=colour, linestyle=":", label=f"{scene}, without queues")
        axis.set(xscale="log", yscale="log", xlabel="thesis [s]", ylabel="RayBatch [s]", title=f"{device_title(report)}: 96 combinations")
        plain_ticks(axis.xaxis, 0.08)
        plain_ticks(axis.yaxis, 0.08)
    legend(figure, axes, 3)
    save(figure, folder, "thesis-initial")
    for name, label in (("ray_count", "rays alive"), ("queue_size", "rays of a block")):
        figure, axes = panels(len(SCENES))
        for axis, scene in zip(axes, SCENES, strict=True):
            sources = [("thesis", {place_of(row, KEYS[name]): row["seconds"] for row in theirs[name]["rows"]})]
            sources += [(device_title(r), {p: s for p, (s, _) in seconds_by_place(r, name).items() if s}) for r in reports.values()]
            for colour, (source, found) in zip(COLOURS, sources, strict=False):
                for storage, style in (("DIRECT", "o-"), ("INDIRECT", "^--")) if name == "queue_size" else ((None, "o-"),):
                    mine = sorted((p[-1], s) for p, s in found.items() if p[0] == scene and (storage is None or p[1] == storage))
                    if mine:
                        best = min(s for p, s in found.items() if p[0] == scene)
                        label_of = source + (f", {storage}" if storage else "")
                        axis.plot([x for x, _ in mine], [s / best for _, s in mine], style, color=colour, markersize=4, label=label_of)
            axis.set(yscale="log", xlabel=label, title=scene)
            axis.set_xscale("log", base=2)
            for report in reports.values() if name == "ray_count" else ():
                most = most_alive(report)
                if most:
                    axis.axvline(most, color="black", linewidth=0.8, linestyle=":", label=f"{device_title(report)}: no more are alive")
            plain_ticks(axis.yaxis, 0.08)
        axes[0].set_ylabel("time over the best")
        legend(figure, axes, 3)
        save(figure, folder, f"thesis-{name.replace('_', '-')}")


STUDY = Study(
    "thesis", "the thesis's three tables (96 combinations, rays alive, sizes of queues) on our tracer, beside its figures", cases, measure,
    fragment, draw, turns=(1, 3),
)  # fmt: skip
