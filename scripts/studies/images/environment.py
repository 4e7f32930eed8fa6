"""Sampling of environments: a sky with a small, bright sun, aimed at by tables of several sizes, and by chance
alone.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.textures.environment import EnvironmentProjection
from raybatch_addon.core.scene.description import Closure, ClosureKind, Image, Material, Scene, World
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.images.textures import Interpolation
from studies import scenes
from studies.bench import Bench, with_frame
from studies.curves import cases_of, curves_table, draw_curves
from studies.light_sampling import sizes
from studies.pages import machine
from studies.study import Case, Options, Report, Row, Study

# Texels around the world of the table that is sampled; 0: none
VARIANTS = {"4096 texels": 4096, "512 texels": 512, "64 texels": 64, "not sampled": 0}
SCENES = ("sun", "overcast")
SUN = 1e5  # times the sky
SUN_RADIUS = np.radians(0.27)
WIDTH = 4096  # of the image


def cases(options: Options) -> list[Case]:
    """All tables of one sky take turns."""
    return cases_of(Case, SCENES, tuple(VARIANTS))


def sky(kind: str) -> np.ndarray:
    """An image of a sky in longitudes and latitudes, linear RGB, float32; bottom row first. With a sun, or without."""
    height = WIDTH // 2
    up = (np.arange(height) + 0.5) / height * np.pi - np.pi / 2
    around = (np.arange(WIDTH) + 0.5) / WIDTH * 2 * np.pi - np.pi
    direction = np.stack(
        [
            np.cos(up)[:, None] * np.cos(around),
            np.cos(up)[:, None] * np.sin(around),
            np.repeat(np.sin(up)[:, None], WIDTH, 1),
        ],
        -1,
    )
    height_part = np.clip(direction[..., 2], 0, 1)[..., None]
    picture = np.where(direction[..., 2:] > 0, np.array([0.5, 0.6, 0.8]) * (0.4 + 0.6 * height_part), 0.1)
    if kind == "sun":
        towards = np.array([0.5, -0.6, 0.62]) / np.linalg.norm([0.5, -0.6, 0.62])
        picture[direction @ towards > np.cos(SUN_RADIUS)] = SUN * 0.5
    return picture.astype(np.float32)


def world(kind: str, sampling_size: int) -> tuple[World, tuple[Image, ...]]:
    """A world that shows `sky(kind)`."""
    builder = ProgramBuilder()
    projection = int(EnvironmentProjection.EQUIRECTANGULAR)
    found = builder.value("environment", 0, int(Interpolation.LINEAR), projection, 0, builder.value("position", 0))
    assert isinstance(found, tuple)  # colour and alpha
    builder.closure("emission", found[0])
    return World(program=builder.finish(), sampling_size=sampling_size), (Image(f"{kind} sky", sky(kind)),)


def scene_named(kind: str) -> Scene:
    """The plates of the other studies without their lamps, under a sky."""
    plates = scenes.plates(64, 64)
    shown, images = world(kind, WIDTH)
    dull = tuple(
        Material(
            m.name,
            tuple(c for c in m.closures if c.kind != ClosureKind.EMISSION)
            or (Closure(ClosureKind.DIFFUSE, (0.5,) * 3),),
            m.kinds,
        )
        for m in plates.materials
    )
    return dataclasses.replace(plates, lights=(), materials=dull, world=shown, images=images)


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """One render with a seed of its own, and its error."""
    name, variant = case.what["scene"], case.what["variant"]
    edge, samples, many = sizes(bench.options)
    scene = with_frame(bench.scene(name, lambda: scene_named(name)), edge, edge)
    settings = RenderSettings(
        sample_count=samples, bounce_max=2, pixel_filter="BOX", sample_sequence="INDEPENDENT", seed=turn + 1
    )
    reference = bench.reference(name, scene, settings.replace(sample_sequence="SOBOL"), many)
    tried = dataclasses.replace(scene, world=dataclasses.replace(scene.world, sampling_size=VARIANTS[variant]))
    return {"edge": edge, **bench.curve(tried, settings, reference, (name, variant))}


def fragment(reports: dict[str, Report]) -> str:
    """Time to the same error."""
    lines = [*(f"- {machine(report)}" for report in reports.values()), "", "![Error against time](environment.svg)", ""]
    return "\n".join([*lines, curves_table(reports, "world is sampled by")])


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Error against time."""
    draw_curves(reports, folder, "environment")


STUDY = Study(
    "environment", "sampling of an image of a sky, with a sun and without", cases, measure, fragment, draw, turns=(2, 3)
)
