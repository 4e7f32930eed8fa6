"""Budgets of images from an eighth of all of them to all, looked up as they are or filtered over footprints."""

from __future__ import annotations

import statistics
import time
from pathlib import Path

from raybatch_addon.core.settings.settings import RenderSettings
from studies.bench import Bench, with_frame
from studies.images import painted_hills
from studies.pages import device_title, films_line, machine, number, table
from studies.rows import differing_films, first_rows
from studies.study import Case, Options, Report, Row, Study

SHARES = (1.0, 0.5, 0.25, 0.125)
FILTERS = {"as they are": "OFF", "filtered": "FOOTPRINT"}
BOUNCES = 3


def cases(options: Options) -> list[Case]:
    """All images in memory, and every budget; look-ups of one kind take turns."""
    return [
        Case(f"{look_up}, {share:.3g}", look_up, {"scene": "hills", "look_up": look_up, "image_share": share})
        for look_up in FILTERS
        for share in SHARES
    ]


def scene_size(options: Options) -> tuple[int, int, int]:
    """Texels along the side of an image, edge of the frame, samples."""
    if options.is_cuda:
        return options.pick((4096, 1024, 16), (8192, 1024, 64))
    return options.pick((1024, 96, 4), (2048, 256, 16))


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """One render; `cost` is its seconds, on a CPU those of processors, so that other work does not count."""
    texels, edge, samples = scene_size(bench.options)
    scene = with_frame(bench.scene(texels, lambda: painted_hills.scene(texels)), edge, edge)
    total, share = painted_hills.image_bytes(scene), case.what["image_share"]
    settings = RenderSettings(
        sample_count=samples,
        bounce_max=BOUNCES,
        kernel_tier="SPECIALISED",
        texture_filter=FILTERS[case.what["look_up"]],
        texture_budget=int(share * total) if share < 1 else 0,
    )
    place = {"edge": edge, "samples": samples, "texels": texels, "image_bytes": total}
    bench.timed(scene, settings.replace(sample_count=1))  # untimed: kernels, images and their levels are there
    began = time.process_time()
    row = bench.timed(scene, settings)
    spent = time.process_time() - began
    return {**place, "cost": row.get("seconds") if bench.options.is_cuda else spent, **row}


def fragment(reports: dict[str, Report]) -> str:
    """Speed by budget."""
    parts = [f"- {machine(report)}" for report in reports.values()]
    rows = []
    wrong, whole = [], 0
    for report in reports.values():
        row = report["rows"][0]
        parts.append(
            f"- {device_title(report)}: {row['image_bytes'] / 1e6:,.0f} MB of images, {row['edge']} x {row['edge']} "
            f"pixels, {row['samples']} samples, {BOUNCES} bounces."
        )
        wrong += differing_films(report["rows"], ("scene", "look_up", "texels", "edge", "samples"))
        whole += sum(bool(each["complete"]) for each in report["rows"])
        costs: dict[str, list[float]] = {}
        for each in report["rows"]:
            costs.setdefault(each["case"], []).append(each["cost"])
        seconds = {key: statistics.median(found) for key, found in costs.items()}
        for key, each in first_rows(report["rows"]).items():
            first = f"{each['look_up']}, {SHARES[0]:.3g}"
            tiles = each.get("tiles") or {}
            rows.append(
                [
                    device_title(report),
                    each["look_up"],
                    "in memory" if each["image_share"] == SHARES[0] else f"{each['image_share']:.3g}",
                    number(seconds.get(key)),
                    number(seconds[first] / seconds[key] if key in seconds and first in seconds else None),
                    tiles.get("tiles"),
                    tiles.get("fetched"),
                    number(tiles["bytes"] / 1e6) if tiles else "",
                    f"{tiles['waited_share']:.1%}" if tiles else "",
                ]
            )
    parts += [f"- {films_line(wrong, whole)}", ""]
    head = [
        "device",
        "images are looked up",
        "budget of all",
        "seconds of processors or GPU",
        "speed over in memory",
        "tiles",
        "fetched",
    ]
    return "\n".join([*parts, table([*head, "fetched [MB]", "look-ups that waited"], rows)])


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Draws nothing: a table says it all."""


ABOUT = "budgets of images from an eighth of all of them to all, with the rest in host memory"
STUDY = Study("image-budgets", ABOUT, cases, measure, fragment, draw, turns=(2, 3))
