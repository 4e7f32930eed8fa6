"""Textures filtered over footprints: error, bias, time and memory against looking up the images themselves."""

from __future__ import annotations

import dataclasses
import statistics
import time
from pathlib import Path

import numpy as np
from lib.command import UsageError

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.textures.image import Projection
from raybatch_addon.core.scene.archive import load_scene
from raybatch_addon.core.scene.description import (
    Camera,
    CameraKind,
    ClosureKind,
    Image,
    ImageEncoding,
    Material,
    Mesh,
    Scene,
)
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.images.textures import Extension, Interpolation
from studies import scenes
from studies.bench import Bench, with_frame
from studies.pages import device_title, machine, table
from studies.study import Case, Options, Report, Row, Study

# Widths that look-ups are filtered over, in footprints; 0: not filtered
VARIANTS = {"off": 0.0, "1 footprint": 1.0, "1/2 footprint": 0.5, "1/4 footprint": 0.25}
BUILT = "checkerboard"
ARCHIVES = ("castle", "interior", "donut", "xmas")  # NAME.scene.npz, written by `render.py --save-scene`


def cases(options: Options) -> list[Case]:
    """All widths of one scene take turns. Archives that are not there are left out."""
    names = [BUILT, *(name for name in ARCHIVES if _found(name, options))]
    return [
        Case(f"{name}, {variant}", name, {"scene": name, "variant": variant}) for name in names for variant in VARIANTS
    ]


def _found(name: str, options: Options) -> Path | None:
    paths = (folder / f"{name}.scene.npz" for folder in options.scenes)
    return next((path for path in paths if path.is_file()), None)


def checkerboard() -> Scene:
    """A plane of black and white squares of half a metre, up to the horizon, which shines by itself."""
    builder = ProgramBuilder()
    place = (0, Interpolation.LINEAR, Extension.REPEAT, Projection.FLAT, 0)
    found = builder.value("image", *place, builder.value("uv", -1, 0))
    assert isinstance(found, tuple)  # colour and alpha
    builder.closure("emission", found[0])
    far = 1000.0
    corners = np.array([[-far, -far], [far, -far], [far, far], [-far, far]], np.float32)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    positions = np.column_stack([corners, np.zeros(4)]).astype(np.float32)
    mesh = Mesh("Floor", positions, triangles, corner_uvs=corners[triangles])
    i = np.arange(256)
    squares = np.where((i[:, None] // 128 + i // 128) % 2, 235, 20).astype(np.uint8)[..., None]
    material = Material("squares", (), (ClosureKind.EMISSION,), builder.finish())
    ahead = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 1.5]], np.float32)
    camera = Camera(CameraKind.PERSPECTIVE, ahead, (-0.5, 0.5, -0.95, 0.05))
    scene = scenes.scene_of([(mesh, material)], camera, 64, 64)
    return dataclasses.replace(scene, images=(Image("squares", squares, ImageEncoding.SRGB),))


def scene_named(name: str, options: Options) -> Scene:
    """A scene that is built here or was saved."""
    if name == BUILT:
        return checkerboard()
    path = _found(name, options)
    if path is None:
        raise UsageError(f"the scene {name} ({name}.scene.npz) was not found: give its folder with --scenes")
    scene, _ = load_scene(path)
    for image in scene.images:
        for pixels in [image.pixels] if image.tiles is None else [pixels for _, pixels in image.tiles]:
            if pixels is not None:
                freeze(pixels)  # so that images and levels are uploaded once
    return scene


def sizes(options: Options) -> tuple[int, int, int]:
    """Edge of the frame, samples, and those of each half of the reference."""
    if options.is_cuda:
        return options.pick((256, 32, 2048), (512, 32, 8192))
    return options.pick((64, 16, 128), (128, 16, 256))


def settings_of(variant: str) -> tuple[RenderSettings, RenderSettings]:
    """Settings of references, and those of a variant."""
    plain = RenderSettings(bounce_max=4, kernel_tier="SPECIALISED")
    width = VARIANTS[variant]
    return plain, plain.replace(texture_filter="FOOTPRINT", texture_filter_width=width) if width else plain


_references: dict[str, tuple[np.ndarray, np.ndarray]] = {}  # of the scene at hand


def measure(case: Case, turn: int, bench: Bench) -> Row:
    """Two renders with seeds of their own, their error, and what of it would stay at infinitely many samples."""
    name = case.what["scene"]
    edge, samples, many = sizes(bench.options)
    scene = with_frame(bench.scene(name, lambda: scene_named(name, bench.options)), edge, edge)
    plain, tried = settings_of(case.what["variant"])

    def render(settings: RenderSettings, seed: int, count: int) -> tuple[np.ndarray, dict, float]:
        began = time.process_time()
        film = bench.session.render(scene, settings.replace(seed=seed, sample_count=count))
        return film.passes["Combined"][..., :3].astype(float), film.statistics, time.process_time() - began

    if name not in _references:
        _references.clear()
        _references[name] = (render(plain, 10_001, many)[0], render(plain, 10_002, many)[0])
    render(tried, 1, 1)  # untimed: kernels and images are loaded
    films = [render(tried, 2 * turn + 2 + k, samples) for k in range(2)]
    first, second = _references[name]
    weight = 1 / (0.25 * (first + second) ** 2 + 0.01 * np.mean(first) ** 2)
    a, b = (film - reference for (film, _, _), reference in zip(films, (first, second), strict=True))
    # products of differences from independent references have no noise of these in their means
    error = [np.mean(weight * (film - first) * (film - second)) for film, _, _ in films]
    reported = films[-1][1]
    return {
        "edge": edge,
        "samples": samples,
        "relmse": float(np.mean(error)),
        "bias": float(np.mean(weight * a * b)),
        "mean": float(np.mean([film for film, _, _ in films]) / np.mean(0.5 * (first + second)) - 1),
        "seconds": reported["seconds"]["render"],
        "processor_seconds": min(seconds for _, _, seconds in films),
        "images": reported["images"],
        "invalid_samples": reported["invalid_samples"],
    }


def fragment(reports: dict[str, Report]) -> str:
    """Each width beside look-ups of the images themselves."""
    lines = [*(f"- {machine(report)}" for report in reports.values()), ""]
    rows = []
    for report in reports.values():
        found: dict[tuple[str, str], list[Row]] = {}
        for row in report["rows"]:
            found.setdefault((row["scene"], row["variant"]), []).append(row)
        for (name, variant), own in found.items():
            off = found[name, "off"]
            error, before = (statistics.mean(row["relmse"] for row in each) for each in (own, off))
            took, took_before = (statistics.median(row["processor_seconds"] for row in each) for each in (own, off))
            bias = max(statistics.mean(row["bias"] for row in own), 0.0)
            rows.append(
                [
                    device_title(report),
                    name,
                    variant,
                    str(own[0]["samples"]),
                    f"{error:.3g}",
                    f"{error / before:.3f}",
                    f"{bias**0.5:.4f}",
                    f"{100 * statistics.mean(row['mean'] for row in own):+.2f} %",
                    f"{took / took_before:.2f}",
                    f"{error * took / (before * took_before):.2f}",
                    f"{own[0]['images']['bytes'] / 1e6:.2f}",
                ]
            )
    head = ["device", "scene", "filtered over", "samples", "relMSE", "of off", "bias", "brightness", "time of off"]
    return "\n".join([*lines, table([*head, "error at equal time", "images [MB]"], rows)])


def draw(reports: dict[str, Report], folder: Path) -> None:
    """Draws nothing: a table says it all."""


ABOUT = "images looked up as they are, or filtered over the footprints of paths: error, bias, time and memory"
STUDY = Study("textures", ABOUT, cases, measure, fragment, draw, turns=(2, 4))
