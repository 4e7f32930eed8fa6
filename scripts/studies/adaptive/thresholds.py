"""Adaptive sampling: samples and time to the same error, with pixels that end by their noise and with all alike."""

from __future__ import annotations

import math
import statistics
from pathlib import Path

import numpy as np

from raybatch_addon.core.scene.archive import load_scene
from raybatch_addon.core.scene.description import Scene
from raybatch_addon.core.settings.settings import RenderSettings
from studies import scenes
from studies.adaptive import bias
from studies.bench import Bench, with_frame
from studies.curves import cases_of
from studies.pages import device_title, machine, number, table
from studies.study import Case, Options, Report, Row

SCENES = ("plates", "room", "bmw", "livingroom")
BUILT = {"plates": scenes.plates, "room": scenes.room}
ALL = "all samples"
THRESHOLDS = ("0.1", "0.05", "0.02")


def cases(options: Options) -> list[Case]:
    """All samples of every pixel beside several thresholds, in turns; and rules that are simulated."""
    return cases_of(Case, SCENES, (ALL, *THRESHOLDS)) + bias.cases()


def scene_named(name: str, options: Options) -> Scene:
    """One of `SCENES`: built here, or an archive of the scene of a .blend file."""
    if name in BUILT:
        return BUILT[name](64, 64)
    return load_scene(scenes.find(name, options))[0]


def sizes(options: Options, name: str) -> tuple[int, int, int]:
    """Edge of the frame, most samples, and those of the reference; of files, whose paths take long, less."""
    if options.is_cuda:
        return options.pick((256, 256, 8192), (512, 1024, 16_384))
    return options.pick((48, 64, 512), (80, 512, 4096) if name in BUILT else (48, 256, 2048))


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """One render with a seed of its own, and its error."""
    name, variant = case.what["scene"], case.what["variant"]
    if name == bias.SIMULATED:
        return bias.measured(case, turn)
    edge, samples, many = sizes(bench.options, name)
    scene = with_frame(bench.scene(name, lambda: scene_named(name, bench.options)), edge, edge)
    settings = RenderSettings(sample_count=samples, bounce_max=4, seed=turn + 1)
    reference = bench.reference(name, scene, settings, many)
    if variant == ALL:
        points = bench.curve(scene, settings, reference, name)
        return {"edge": edge, **points, **bench.compared(scene, settings, reference, name)}
    settings = settings.replace(adaptive_sampling="ON", noise_threshold=float(variant))
    return {"edge": edge, **bench.compared(scene, settings, reference, (name, "adaptive"))}


def needed(points: list[Row], measure: str, error: float) -> float:
    """Samples after which a render of all samples has an error, between its points and beyond their end."""
    errors, samples = (np.log([point[key] for point in points]) for key in (measure, "samples"))
    order = np.argsort(errors)
    errors, samples, wanted = errors[order], samples[order], math.log(error)
    if wanted < errors[0]:  # beyond the last sample: as it fell last
        slope = (samples[min(2, len(samples) - 1)] - samples[0]) / (errors[min(2, len(errors) - 1)] - errors[0])
        return math.exp(samples[0] + (wanted - errors[0]) * slope)
    return math.exp(np.interp(wanted, errors, samples))


def fragment(reports: dict[str, Report]) -> str:
    """What each threshold costs, and what all samples of every pixel cost for the same error."""
    lines = [*(f"- {machine(report)}" for report in reports.values()), ""]
    rows = []
    for report in reports.values():
        for name in SCENES:
            plain = [row for row in report["rows"] if row["scene"] == name and row["variant"] == ALL]
            if not plain:
                continue
            points = [
                {key: statistics.median(p[key] for p in point) for key in ("samples", "relmse", "rmse")}
                for point in zip(*(row["points"] for row in plain), strict=True)
            ]
            each = statistics.median(row["cost"] for row in plain) / points[-1]["samples"]
            for variant in THRESHOLDS:
                mine = [row for row in report["rows"] if row["scene"] == name and row["variant"] == variant]
                if mine:
                    rows.append([device_title(report), name, variant, *_figures(mine, points, each)])
    head = ["device", "scene", "threshold", "mean samples", "converged", "relMSE", "seconds of processors"]
    head += ["samples: gain", "time: gain", "samples: gain by RMSE", "time: gain by RMSE", "mean over reference"]
    return "\n".join([*lines, table(head, rows), "", bias.bias_table(next(iter(reports.values())))])


def _figures(rows: list[Row], points: list[Row], cost: float) -> list[str]:
    """`cost`: seconds of a sample of every pixel, where all get all samples."""
    reported = {
        key: statistics.median(row[key] for row in rows)
        for key in ("samples_mean", "converged", "relmse", "rmse", "cost")
    }
    gains = []
    for measure in ("relmse", "rmse"):
        samples = needed(points, measure, reported[measure])
        gains += [f"{samples / reported['samples_mean']:.2f}", f"{samples * cost / reported['cost']:.2f}"]
    brighter = [row["brightness"] - 1.0 for row in rows]
    spread = f" ± {100 * statistics.stdev(brighter) / math.sqrt(len(brighter)):.2f} %" if len(brighter) > 1 else ""
    return [
        f"{reported['samples_mean']:.0f}",
        f"{100 * reported['converged']:.0f} %",
        number(reported["relmse"]),
        number(reported["cost"]),
        *gains,
        f"{100 * statistics.mean(brighter):+.2f} %{spread}",
    ]


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Draws nothing: a table says it all."""
