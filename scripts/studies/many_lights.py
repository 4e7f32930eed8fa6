"""Many lights: the error of the same light from 10 to 10,000 sources, at equal samples and at equal time."""

from __future__ import annotations

import dataclasses
import math
import statistics
from pathlib import Path

import numpy as np
from lib.geometry_files import View, look_at

from raybatch_addon.core.scene.description import Light, LightKind, Mesh, Scene
from raybatch_addon.core.settings.settings import RenderSettings
from studies import scenes
from studies.bench import Bench
from studies.pages import device_title, machine, table
from studies.study import Case, Options, Report, Row, Study

KINDS = ("lamps", "glowing triangles")
COUNTS = (10, 100, 1000, 10_000)
HALF = 8.0  # of the square that holds all lights [m]
HEIGHT = 3.0  # of the lights above the floor [m]
POWER = 60.0  # of all lamps together: sum of their intensities [W/sr]
AREA = 1.0  # of all glowing triangles together [m²]


def cases(options: Options) -> list[Case]:
    """Counts take turns."""
    counts = options.pick(COUNTS[::2], COUNTS)
    return [
        Case(f"{kind}, {count:,}", kind, {"scene": f"hall:{kind}:{count}", "kind": kind, "count": count})
        for kind in KINDS
        for count in counts
    ]


def hall(kind: str, count: int, edge: int) -> Scene:
    """A floor with pillars, under `count` lights whose power, and the area that they are spread over, are always the
    same.
    """
    rng = np.random.default_rng(count)
    rows = math.ceil(math.sqrt(count))
    cells = rng.permutation(rows * rows)[:count]  # jittered, so that no count leaves a part of the square dark
    x, y = (HALF * (2 * (cell + rng.random(count)) / rows - 1) for cell in (cells % rows, cells // rows))
    things = [(scenes.quad("Floor", [(-20, -20, 0), (20, -20, 0), (20, 20, 0), (-20, 20, 0)]), scenes.diffuse(0.6))]
    things += [
        (_pillar(f"Pillar {i}", 4.0 * (i % 3 - 1), 4.0 * (i // 3 - 1)), scenes.diffuse((0.7, 0.6, 0.5)))
        for i in range(9)
    ]
    lights: tuple[Light, ...] = ()
    if kind == "lamps":
        lights = tuple(
            Light(
                f"Lamp {i}",
                LightKind.POINT,
                np.column_stack([np.eye(3), [x[i], y[i], HEIGHT]]).astype(np.float32),
                (POWER / count,) * 3,
                radius=0.01,
                soft_falloff=False,
                visibility=scenes.HIDDEN,
            )
            for i in range(count)
        )
    else:
        side = math.sqrt(2 * AREA / count)
        corners = np.stack([x, y, np.full(count, HEIGHT)], 1)[:, None] + side * np.eye(3)[None] * [1, 1, 0]
        triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
        glowing = Mesh("Lights", corners.reshape(-1, 3).astype(np.float32), triangles)
        things.append((glowing, scenes.glow(POWER / AREA)))
    view = View((0.0, -11.0, 6.0), (0.0, 0.0, 0.5), math.radians(55))
    scene = scenes.scene_of(things, look_at(view, "z", edge, edge), edge, edge, lights)
    # the camera does not see what glows: many small things at edges of pixels would make most of the error
    visibility = scene.instances.visibility.copy()
    visibility[10:] = scenes.HIDDEN
    return dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, visibility=visibility))


def _pillar(name: str, x: float, y: float) -> Mesh:
    corners = np.array([(x + dx, y + dy, z) for z in (0.0, 1.5) for dx, dy in _SQUARE], np.float32)
    sides = [quad for i in range(4) for quad in ((i, (i + 1) % 4, 4 + i), ((i + 1) % 4, 4 + (i + 1) % 4, 4 + i))]
    return Mesh(name, corners, np.array([*sides, (4, 5, 6), (4, 6, 7)], np.int32))


_SQUARE = ((-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4))


def sizes(options: Options) -> tuple[int, int, int]:
    """Edge of the frame, samples, and those of the reference."""
    if options.is_cuda:
        return options.pick((256, 256, 8192), (512, 1024, 16_384))
    return options.pick((64, 64, 1024), (96, 128, 4096))


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """One render with a seed of its own, and its error."""
    edge, samples, many = sizes(bench.options)
    kind, count = case.what["kind"], case.what["count"]
    scene = bench.scene(case.key, lambda: hall(kind, count, edge))
    settings = RenderSettings(
        sample_count=samples, bounce_max=0, pixel_filter="BOX", sample_sequence="INDEPENDENT", seed=turn + 1
    )
    reference = bench.reference(case.key, scene, settings.replace(sample_sequence="SOBOL"), many)
    return {"edge": edge, "samples": samples, **bench.curve(scene, settings, reference, case.key)}


def fragment(reports: dict[str, Report]) -> str:
    """Error and time of each count over those of the fewest lights."""
    lines = [*(f"- {machine(report)}" for report in reports.values()), ""]
    rows = []
    for report in reports.values():
        found: dict[tuple[str, int], list[Row]] = {}
        for row in report["rows"]:
            found.setdefault((row["kind"], row["count"]), []).append(row)
        figures = {
            key: (_median(rows, lambda row: row["points"][-1]["relmse"]), _median(rows, lambda row: row["seconds"]))
            for key, rows in found.items()
        }
        for (kind, count), (error, seconds) in sorted(figures.items()):
            few = figures[kind, min(number for each, number in figures if each == kind)]
            rows.append(
                [
                    device_title(report),
                    kind,
                    f"{count:,}",
                    str(found[kind, count][0]["samples"]),
                    f"{error:.3g}",
                    f"{seconds:.3g}",
                    f"{error / few[0]:.2f}",
                    f"{seconds / few[1]:.2f}",
                    f"{error * seconds / (few[0] * few[1]):.2f}",
                ]
            )
    head = ["device", "lights", "number", "samples", "relMSE", "seconds", "variance", "time", "variance at equal time"]
    return "\n".join([*lines, table(head, rows)])


def _median(rows: list[Row], figure) -> float:
    return statistics.median(map(figure, rows))


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Draws nothing: a table says it all."""


ABOUT = "the same light from 10 to 10,000 sources: error at equal samples and at equal time"
STUDY = Study("many-lights", ABOUT, cases, measure, fragment, draw, turns=(2, 3))
