"""Memory budgets from a twentieth of the geometry to all of it, with the rest in the host's memory or on disk."""

from __future__ import annotations

from pathlib import Path

from raybatch_addon.core.settings.settings import RenderSettings
from studies import scenes
from studies.bench import Bench, with_frame
from studies.pages import device_title, films_line, machine, number, table
from studies.rows import differing_films, first_rows, medians
from studies.study import Case, Options, Report, Row, Study

SHARES = (0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
WHOLE = "in memory"
BOUNCES = 4


def cases(options: Options) -> list[Case]:
    """All in memory without queues, then every budget with either store behind it."""
    mesh = scene_size(options)[0]
    found = [Case(WHOLE, "budgets", {"scene": mesh, "store": WHOLE, "budget_share": 1.0})]
    for store in ("HOST", "DISK"):
        for share in options.pick((0.05, 0.2, 0.5, 1.0), SHARES):
            found.append(
                Case(f"{store} {share:.0%}", "budgets", {"scene": mesh, "store": store, "budget_share": share})
            )
    return found


def scene_size(options: Options) -> tuple[str, int, int, int]:
    """Mesh, copies along either side, edge of the frame, samples."""
    if options.is_cuda:
        return options.pick(("dragon", 4, 1280, 8), ("dragon", 8, 1280, 16))
    return options.pick(("bunny", 1, 96, 2), ("dragon", 2, 640, 4))


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """One render; the first shows how many bytes all of the geometry takes."""
    mesh, count, edge, samples = scene_size(bench.options)
    scene = with_frame(bench.scene((mesh, count), lambda: scenes.grid(mesh, bench.options, count, 64)), edge, edge)
    settings = RenderSettings(sample_count=samples, bounce_max=BOUNCES, roulette_bounce=100_000, spatial_splits="OFF")
    place = {
        "grid": count,
        "edge": edge,
        "samples": samples,
        "triangles": sum(len(each.triangles) for each in scene.meshes),
    }
    if case.what["store"] == WHOLE:
        row = bench.timed(scene, settings.replace(batching="OFF"), case.key)
        bench.geometry_bytes = row["tree_bytes"]
        return {**place, **row}
    if bench.geometry_bytes is None:  # this run goes on where another ended
        bench.geometry_bytes = bench.timed(scene, settings.replace(batching="OFF", sample_count=1))["tree_bytes"]
    budget = max(1, int(case.what["budget_share"] * bench.geometry_bytes))
    limited = settings.replace(geometry_budget=budget, geometry_store=case.what["store"])
    return {**place, "geometry_bytes": bench.geometry_bytes, "budget": budget, **bench.timed(scene, limited, case.key)}


# --- tables


def fragment(reports: dict[str, Report]) -> str:
    """Speed by budget and store."""
    parts = [f"- {machine(report)}" for report in reports.values()]
    for report in reports.values():
        row = report["rows"][0]
        parts.append(
            f"- {device_title(report)}: {row['grid']} x {row['grid']} {row['scene']}, {row['triangles']:,} triangles, "
            f"{(row['tree_bytes'] or 0) / 1e6:,.0f} MB of tree and triangles; {row['edge']} x {row['edge']} pixels, "
            f"{row['samples']} samples, {BOUNCES} bounces."
        )
    wrong = [
        each
        for report in reports.values()
        for each in differing_films(report["rows"], ("scene", "grid", "edge", "samples"))
    ]
    whole = sum(bool(row["complete"]) for report in reports.values() for row in report["rows"])
    parts += [f"- {films_line(wrong, whole)}", "", "![Speed by budget](budgets.svg)", ""]
    rows = []
    for report in reports.values():
        seconds = medians(report["rows"])
        for key, row in first_rows(report["rows"]).items():
            speed = seconds[WHOLE] / seconds[key] if key in seconds and WHOLE in seconds else None
            rows.append(
                [
                    device_title(report),
                    row["store"],
                    "" if row["store"] == WHOLE else f"{row['budget_share']:.0%}",
                    number(seconds.get(key)),
                    number(speed),
                    row.get("method") if not row.get("refused") else f"refused: {row['refused']}",
                    _megabytes(row.get("resident_peak")),
                    _megabytes(row.get("bytes_copied")),
                    row.get("pages_loaded"),
                    number(row.get("treelet_visits_per_ray")),
                ]
            )
    heads = [
        "device",
        "store",
        "budget",
        "seconds",
        "speed over in memory",
        "batching",
        "held at most [MB]",
        "copied [MB]",
        "pages brought in",
        "treelets visited by a ray",
    ]
    return "\n".join([*parts, table(heads, rows)])


def _megabytes(count: int | None) -> str:
    return "" if not count else number(count / 1e6)


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Speed over that in memory, by share of the geometry."""
    from studies.plots import BLUE, RED, legend, panels, save

    figure, axes = panels(len(reports))
    for axis, report in zip(axes, reports.values(), strict=True):
        seconds = medians(report["rows"])
        for store, color in (("HOST", BLUE), ("DISK", RED)):
            mine = [
                (key, row)
                for key, row in first_rows(report["rows"]).items()
                if row["store"] == store and key in seconds
            ]
            points = [(row["budget_share"], seconds[WHOLE] / seconds[key]) for key, row in mine]
            if points:
                label = f"rest in {'host memory' if store == 'HOST' else 'a file'}"
                axis.plot(*zip(*sorted(points), strict=True), "o-", color=color, markersize=4, label=label)
        axis.axhline(1, color="black", linewidth=0.8, label="all in memory, unbatched")
        title = f"{device_title(report)}, {report['rows'][0]['triangles'] / 1e6:.1f}M triangles"
        axis.set(xlabel="budget over geometry", ylim=(0, None), xlim=(0, 1.03), title=title)
    axes[0].set_ylabel("speed over all in memory")
    legend(figure, axes)
    save(figure, folder, "budgets")


ABOUT = "memory budgets from a twentieth of the geometry to all of it, host memory and disk behind"
STUDY = Study("budgets", ABOUT, cases, measure, fragment, draw, turns=(2, 3))
