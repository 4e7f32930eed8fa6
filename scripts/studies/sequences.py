"""Sample sequences: error against samples and against time."""

from __future__ import annotations

from pathlib import Path

from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings
from studies.bench import Bench, with_frame
from studies.curves import cases_of, curves_table, draw_curves
from studies.light_sampling import scene_named, sizes
from studies.pages import machine
from studies.study import Case, Options, Report, Row, Study

SCENES = ("plates", "room", "dragon: direct light", "dragon", "sponza")
BOUNCES = {"plates": 0, "dragon: direct light": 0}  # else 4


def cases(options: Options) -> list[Case]:
    """Every sequence that there is, and few bounces beside many."""
    names = tuple(choice[0] for choice in SETTINGS["sample_sequence"].choices)
    return cases_of(Case, SCENES, names)


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """One render with a seed of its own, and its error."""
    name = case.what["scene"]
    edge, samples, many = sizes(bench.options)
    file = name.split(":")[0]
    scene = with_frame(bench.scene(file, lambda: scene_named(file, bench.options)), edge, edge)
    settings = RenderSettings(sample_count=samples, bounce_max=BOUNCES.get(name, 4), pixel_filter="BOX", seed=turn + 1)
    reference = bench.reference(name, scene, settings, many)
    sequence = case.what["variant"]
    return {"edge": edge, **bench.curve(scene, settings.replace(sample_sequence=sequence), reference, (name, sequence))}


def fragment(reports: dict[str, Report]) -> str:
    """Slopes, and time to the same error."""
    lines = [
        *(f"- {machine(report)}" for report in reports.values()),
        "",
        "![Error against samples](sequences-samples.svg)",
        "",
    ]
    lines += ["![Error against time](sequences-seconds.svg)", ""]
    return "\n".join([*lines, curves_table(reports, "sequence")])


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Error against samples and against time."""
    for x in ("samples", "seconds"):
        draw_curves(reports, folder, f"sequences-{x}", (x,))


STUDY = Study(
    "sequences",
    "sample sequences: error against samples and time, with fitted slopes",
    cases,
    measure,
    fragment,
    draw,
    turns=(2, 4),
)
