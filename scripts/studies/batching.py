"""Batching off, on and left to RayBatch, by number of bounces and by size of the scene, with all geometry in memory."""

from __future__ import annotations

from pathlib import Path

from raybatch_addon.core.settings.settings import RenderSettings
from studies import scenes
from studies.bench import Bench, with_frame
from studies.pages import device_title, films_line, machine, number, table
from studies.rows import differing_films, first_rows, medians
from studies.study import Case, Options, Report, Row, Study

MODES = ("OFF", "ON", "AUTO")
BOUNCES = (0, 1, 2, 4, 8, 16)
ROOMS = ("sponza", "san_miguel")
GRIDS = {
    (True, True): (1, 2, 4),
    (True, False): (1, 2, 4, 8),
    (False, True): (1, 2, 3),
    (False, False): (1, 2, 4),
}  # by (cuda, quick)
GRID_BOUNCES = 4


def cases(options: Options) -> list[Case]:
    """Modes of one scene and number of bounces take turns."""
    found = []
    for room in ROOMS:
        for bounces in options.pick((0, 1, 4, 16), BOUNCES):
            for mode in MODES:
                what = {"axis": "bounces", "scene": room, "bounces": bounces, "batching": mode}
                found.append(Case(f"bounces {room} {bounces} {mode}", f"bounces {room}", what))
    mesh = "dragon" if options.is_cuda else "bunny"
    for count in GRIDS[options.is_cuda, options.quick]:
        for mode in MODES:
            what = {"axis": "size", "scene": mesh, "grid": count, "bounces": GRID_BOUNCES, "batching": mode}
            found.append(Case(f"size {mesh} {count} x {count} {mode}", f"size {mesh} {count}", what))
    return found


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """One render."""
    options, what = bench.options, case.what
    edge, samples = (options.pick((640, 4), (1280, 8))) if options.is_cuda else options.pick((96, 2), (320, 2))
    if what["axis"] == "bounces":
        scene = bench.scene(what["scene"], lambda: scenes.under_the_sky(what["scene"], options, 64))
    else:
        scene = bench.scene(
            (what["scene"], what["grid"]), lambda: scenes.grid(what["scene"], options, what["grid"], 64)
        )
    # no Russian roulette: every path is as long as it is asked for, but for those that leave the scene
    settings = RenderSettings(
        sample_count=samples, bounce_max=what["bounces"], roulette_bounce=100_000, batching=what["batching"]
    )
    # spatial splits would make the largest trees take most of the study's time to build
    settings = settings.replace(spatial_splits="OFF" if what["axis"] == "size" else "AUTO")
    row = bench.timed(with_frame(scene, edge, edge), settings, (what["scene"], what.get("grid"), what["batching"]))
    return {"edge": edge, "samples": samples, "triangles": sum(len(mesh.triangles) for mesh in scene.meshes), **row}


# --- tables


def fragment(reports: dict[str, Report]) -> str:
    """Rates by bounces and by size, and the films compared."""
    parts = [f"- {machine(report)}" for report in reports.values()]
    wrong = [
        each
        for report in reports.values()
        for each in differing_films(report["rows"], ("scene", "grid", "bounces", "edge", "samples"))
    ]
    parts += [f"- {films_line(wrong, sum(len(report['rows']) for report in reports.values()))}", ""]
    parts += ["![Batching by bounces and size](batching.svg)", "", "Millions of rays a second:", ""]
    rows = []
    for report in reports.values():
        seconds, first = medians(report["rows"]), first_rows(report["rows"])
        for key, row in first.items():
            if row["batching"] != "OFF":
                continue
            peers = [key[: -len("OFF")] + mode for mode in MODES]
            rates = [first[peer]["rays"] / seconds[peer] / 1e6 if peer in seconds else None for peer in peers]
            on = first.get(peers[1], {})
            rows.append(
                [
                    device_title(report),
                    row["scene"],
                    f"{row.get('triangles', 0):,}",
                    row["bounces"],
                    *map(number, rates),
                    number(rates[1] / rates[0] if rates[0] and rates[1] else None),
                    first.get(peers[2], {}).get("method"),
                    number(on.get("treelet_visits_per_ray")),
                ]
            )
    heads = [
        "device",
        "scene",
        "triangles",
        "bounces",
        "off",
        "on",
        "auto",
        "on over off",
        "auto chose",
        "treelets visited by a ray (on)",
    ]
    return "\n".join([*parts, table(heads, rows)])


def draw(reports: dict[str, Report], folder: Path) -> None:
    """The rate of batching over that of the control, by bounces and by triangles."""
    from studies.plots import COLORS, legend, panels, save

    figure, axes = panels(2)
    colors = iter(COLORS)
    for report in reports.values():
        seconds, first = medians(report["rows"]), first_rows(report["rows"])
        for axis, name, x in ((axes[0], "bounces", "bounces"), (axes[1], "size", "triangles")):
            for scene in dict.fromkeys(row["scene"] for row in report["rows"] if row["axis"] == name):
                color = next(colors)
                for mode, style in (("ON", "o-"), ("AUTO", "s:")):
                    points = []
                    for key, row in first.items():
                        off = key[: -len(mode)] + "OFF"
                        if (
                            row["axis"] == name
                            and row["scene"] == scene
                            and row["batching"] == mode
                            and off in seconds
                            and key in seconds
                        ):
                            points.append((row[x] + (name == "bounces"), seconds[off] / seconds[key]))
                    if points:
                        label = f"{device_title(report)}, {scene}, {mode.lower()}"
                        axis.plot(*zip(*sorted(points), strict=True), style, color=color, markersize=4, label=label)
    for axis, label in zip(axes, ("bounces", "triangles"), strict=True):
        axis.axhline(1, color="black", linewidth=0.8)
        axis.set(xlabel=label, ylim=(0, None))
    axes[0].set_xscale("log", base=2)
    steps = sorted(
        {row["bounces"] for report in reports.values() for row in report["rows"] if row["axis"] == "bounces"}
    )
    axes[0].set_xticks([bounces + 1 for bounces in steps], steps)
    axes[0].minorticks_off()
    axes[1].set_xscale("log")
    sizes = sorted(
        {
            row["triangles"]
            for report in reports.values()
            for row in report["rows"]
            if row["axis"] == "size" and "triangles" in row
        }
    )
    axes[1].set_xticks(sizes, [f"{size / 1e6:.2g}M" for size in sizes])
    axes[1].minorticks_off()
    axes[0].set_ylabel("speed over unbatched (1 = as fast)")
    legend(figure, axes, 3)
    save(figure, folder, "batching")


ABOUT = "batching off, on and automatic, by bounces and by size of the scene, all in memory"
STUDY = Study("batching", ABOUT, cases, measure, fragment, draw, turns=(2, 3))
