"""RayBatch against Cycles at equal error, on five scenes. Needs bpy; each comparison is a run of `benchmark.py render`
of its own.
"""

from __future__ import annotations

import importlib.util
import json
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

from lib.command import UsageError

from studies import scenes
from studies.bench import Bench
from studies.pages import machine, number, table
from studies.rows import first_rows
from studies.study import Case, Options, Report, Row, Study

SCRIPTS = Path(__file__).resolve().parents[1]
SCENES = ("demo", "dragon", "sponza", "san_miguel", "bunny")
ON_A_STAGE = (
    "dragon",
    "bunny",
)  # on a floor under an area light; the others under a sun and a white world, from inside
ENGINES = ("raybatch", "cycles")
BOUNCES = 4
TIMEOUT = 1800  # [s], of one comparison


def cases(options: Options) -> list[Case]:
    """One a scene."""
    return [Case(scene, scene, {"scene": scene}) for scene in SCENES]


def blend_of(name: str, options: Options) -> Path:
    """The .blend of a scene, made where it is not there yet; raises `UsageError`."""
    if importlib.util.find_spec("bpy") is None:
        raise UsageError("the study cycles needs Blender's Python module bpy, which cannot be imported here")
    path = options.cache / f"{name}.blend"
    if path.is_file():
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    if name == "demo":
        command: list[Any] = [SCRIPTS / "make_demo.py", path]
    else:
        command = [SCRIPTS / "mesh_to_blend.py", scenes.find(name, options), path, "--up", scenes.FILES[name][1]]
        if name in ON_A_STAGE:
            command.append("--stage")
        else:
            eye, target, fov = scenes.VIEWS[name]
            command.append(f"--camera={','.join(map(str, (*eye, *target, fov)))}")
        if name == "sponza":
            command += ["--drop", str(scenes.STRAY_BANNER)]
    _run(command)
    return path


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """Both engines in turn, and their errors."""
    options = bench.options
    width, height, samples, runs = options.pick((96, 96, 4, 1), (320, 320, 32, 3))
    path = blend_of(case.what["scene"], options)
    report = json.loads(
        _run(
            [
                SCRIPTS / "benchmark.py",
                "render",
                path,
                "--device",
                bench.options.device,
                "--against",
                "cycles",
                "--equal-error",
                "--samples",
                samples,
                "--bounces",
                BOUNCES,
                "--size",
                f"{width}x{height}",
                "--runs",
                runs,
                "--json",
                "-",
            ]
        )
    )
    return {
        "seconds": report["raybatch"]["seconds"],
        "complete": True,
        "share": 1.0,
        "width": width,
        "height": height,
        "samples": samples,
        "triangles": report["triangles"],
        "rays": report["rays"]["total"],
        "invalid_samples": report["invalid_samples"],
        "raybatch": report["raybatch"],
        "cycles": report["cycles"],
        "equal_error": report["equal_error"],
    }


def _run(command: list[Any]) -> str:
    """What a script of ours writes; raises `UsageError` with its last words."""
    done = subprocess.run(
        [sys.executable, *map(str, command)], capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=TIMEOUT
    )
    if done.returncode:
        last = [line for line in done.stderr.splitlines() if line.strip()][-1:] or ["it said nothing"]
        raise UsageError(f"{command[0].name} failed: {last[0]}")
    return done.stdout


def fragment(reports: dict[str, Report]) -> str:
    """Times at equal samples and at equal error."""
    parts = [*(f"- {machine(report)}" for report in reports.values()), "", "![Against Cycles](cycles.svg)", ""]
    rows = []
    for report in reports.values():
        for scene in first_rows(report["rows"]):
            mine = [row for row in report["rows"] if row["case"] == scene and row.get("equal_error")]
            if not mine:
                continue
            row, equal = mine[0], [each["equal_error"] for each in mine]
            seconds = [statistics.median(each[engine]["seconds"] for each in mine) for engine in ENGINES]
            errors = [statistics.median(each["relmse"][engine] for each in equal) for engine in ENGINES]
            brightness, ratio = (
                statistics.median(each[name] for each in equal) for name in ("mean_ratio", "raybatch_over_cycles")
            )
            rows.append(
                [
                    scene,
                    f"{row['triangles']:,}",
                    row["samples"],
                    *map(number, seconds),
                    *map(number, errors),
                    f"{brightness:.4f}",
                    f"**{number(ratio)}**",
                ]
            )
    heads = [
        "scene",
        "triangles",
        "samples",
        "RayBatch [s]",
        "Cycles [s]",
        "relMSE RayBatch",
        "relMSE Cycles",
        "brightness, ratio",
        "time at equal error, RayBatch over Cycles",
    ]
    return "\n".join([*parts, table(heads, rows)])


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Time of RayBatch over that of Cycles: of a sample, and at equal error."""
    from studies.plots import BLUE, GREY, legend, panels, save

    figure, axes = panels(len(reports), 6.5)
    for axis, report in zip(axes, reports.values(), strict=True):
        names = [
            scene
            for scene in first_rows(report["rows"])
            if any(row["case"] == scene and row.get("equal_error") for row in report["rows"])
        ]
        for offset, color, label, figure_of in (
            (-0.2, GREY, "at equal samples", lambda row: row["raybatch"]["seconds"] / row["cycles"]["seconds"]),
            (0.2, BLUE, "at equal error", lambda row: row["equal_error"]["raybatch_over_cycles"]),
        ):
            heights = [
                statistics.median(figure_of(row) for row in report["rows"] if row["case"] == name) for name in names
            ]
            bars = axis.bar([index + offset for index in range(len(names))], heights, 0.38, color=color, label=label)
            for text in axis.bar_label(bars, [f"{height:.2f}" for height in heights], fontsize=7, padding=1):
                text.set_bbox(
                    {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
                )  # the line at 1 may pass behind it
        axis.axhline(1, color="black", linewidth=0.8)
        axis.margins(y=0.12)
        axis.set_xticks(range(len(names)), names)
        axis.set_ylabel("time of RayBatch over that of Cycles")
    legend(figure, axes)
    save(figure, folder, "cycles")


STUDY = Study(
    "cycles", "RayBatch against Cycles at equal error, on five scenes", cases, measure, fragment, draw, turns=(1, 2)
)
