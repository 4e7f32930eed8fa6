"""Ways to find light: light sampling and BSDF sampling together (multiple importance sampling), and either strategy
alone.
"""

from __future__ import annotations

from pathlib import Path

from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.settings.settings import RenderSettings
from studies import scenes
from studies.bench import Bench, with_frame
from studies.curves import cases_of, curves_table, draw_curves
from studies.pages import machine
from studies.study import Case, Options, Report, Row, Study

VARIANTS = {
    "both (MIS)": {"nee": "ON", "mis": "ON"},
    "light sampling alone": {"nee": "ON", "mis": "OFF"},
    "BSDF sampling alone (NEE off)": {"nee": "OFF", "mis": "ON"},
}
SCENES = ("plates", "room", "dragon", "sponza")
BOUNCES = {"plates": 0}  # else 4: what plates mirror onto the wall would drown what they show themselves


def cases(options: Options) -> list[Case]:
    """All ways of one scene take turns."""
    return cases_of(Case, SCENES, tuple(VARIANTS))


def scene_named(name: str, options: Options) -> Scene:
    """One of `SCENES`."""
    if name == "plates":
        return scenes.plates(64, 64)
    return scenes.room(64, 64) if name == "room" else scenes.under_a_plane(name, options, 64)


def sizes(options: Options) -> tuple[int, int, int]:
    """Edge of the frame, samples, and those of the reference."""
    if options.is_cuda:
        return options.pick((256, 256, 8192), (512, 1024, 16_384))
    return options.pick((64, 64, 1024), (96, 256, 4096))


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """One render with a seed of its own, and its error."""
    name = case.what["scene"]
    edge, samples, many = sizes(bench.options)
    scene = with_frame(bench.scene(name, lambda: scene_named(name, bench.options)), edge, edge)
    settings = RenderSettings(
        sample_count=samples,
        bounce_max=BOUNCES.get(name, 4),
        pixel_filter="BOX",
        sample_sequence="INDEPENDENT",
        seed=turn + 1,
    )
    reference = bench.reference(name, scene, settings.replace(sample_sequence="SOBOL"), many)
    return {
        "edge": edge,
        **bench.curve(
            scene, settings.replace(**VARIANTS[case.what["variant"]]), reference, (name, case.what["variant"])
        ),
    }


def fragment(reports: dict[str, Report]) -> str:
    """Time to the same error."""
    lines = [
        *(f"- {machine(report)}" for report in reports.values()),
        "",
        "![Error against time](light-sampling.svg)",
        "",
    ]
    return "\n".join([*lines, curves_table(reports, "light is found by")])


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Error against time."""
    draw_curves(reports, folder, "light-sampling")


ABOUT = "light sampling on and off, and multiple importance sampling against either strategy alone"
STUDY = Study("light-sampling", ABOUT, cases, measure, fragment, draw, turns=(2, 3))
