"""Whole pictures by two engines, with Cycles made unbiased, and their difference without noise.

Every engine renders a scene twice, with seeds of its own; its picture is the mean of the two, whose variance in a pixel
is estimated by (first - second)^2 / 4. With A the picture by RayBatch and B that by Cycles, the expectation of (A -
B)^2 is their true difference squared plus both variances, so that

    relMSE = mean(((A - B)^2 - (A1 - A2)^2 / 4 - (B1 - B2)^2 / 4) / (B^2 + EPSILON))

estimates the difference without the noise; it may come out below zero.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from raybatch_addon.blender import frame, reports

EPSILON = 1e-2  # keeps nearly black pixels from counting most
BOUNCES = 6
GREY = 0.2  # what pictures with alpha are laid over


class RenderFailed(Exception):
    """RayBatch gave no picture; the message is the engine's."""


@dataclass
class Picture:
    """Two independent renders of one engine: linear float64 [height, width, 3], bottom row first."""

    first: np.ndarray
    second: np.ndarray
    warnings: list[str] = field(default_factory=list)

    @property
    def mean(self) -> np.ndarray:
        """Mean of both renders."""
        return (self.first + self.second) / 2

    @property
    def variance(self) -> np.ndarray:
        """Variance of each pixel of `mean`, estimated from the two renders."""
        return (self.first - self.second) ** 2 / 4


@dataclass(frozen=True)
class Figures:
    """Comparison of two pictures."""

    ours: np.ndarray  # [3], mean of each channel
    theirs: np.ndarray  # [3]
    deviations: np.ndarray  # [3], difference of the means over its standard error
    noise: float  # largest standard error of a channel's ratio of means
    rel_mse: float
    rel_mse_noise: float  # standard error of `rel_mse`

    @property
    def ratios(self) -> np.ndarray:
        """Ours over theirs, [3]; 1 where both are black."""
        dark = np.maximum(self.ours, self.theirs) <= 1e-12
        return np.where(dark, 1.0, self.ours / np.where(dark, 1.0, np.maximum(self.theirs, 1e-12)))

    @property
    def mean_error(self) -> float:
        """Largest relative difference of a channel's mean."""
        return float(np.abs(self.ratios - 1).max())


def rel_mse(ours: Picture, theirs: Picture) -> float:
    """relMSE of the module's docstring."""
    return float(_differences(ours, theirs).mean())


def _differences(ours: Picture, theirs: Picture) -> np.ndarray:
    difference = (ours.mean - theirs.mean) ** 2 - ours.variance - theirs.variance
    return difference / (theirs.mean**2 + EPSILON)


def figures_of(ours: Picture, theirs: Picture) -> Figures:
    """The figures of two pictures of one size."""
    means = ours.mean.mean((0, 1)), theirs.mean.mean((0, 1))
    pixels = ours.first.shape[0] * ours.first.shape[1]
    error = np.sqrt((ours.variance + theirs.variance).sum((0, 1))) / pixels
    differences = _differences(ours, theirs)
    return Figures(
        means[0],
        means[1],
        (means[0] - means[1]) / np.maximum(error, 1e-12),
        float((error / np.maximum(means[1], 1e-12)).max()),
        float(differences.mean()),
        float(differences.mean(-1).std() / np.sqrt(pixels)),
    )


# --- the scene, with the same settings for both


def empty_scene() -> bpy.types.Scene:
    """The empty one of Blender's factory scenes, with RayBatch as its engine, and only a camera in it.

    The add-on is registered. Preferences stay as they are.
    """
    # not read_factory_settings, which takes six times as long: it also registers every add-on of Blender's anew
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0, 0, 10)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "RAYBATCH"
    scene.render.resolution_percentage = 100
    scene.raybatch.device = "cpu"
    return scene


def set_alike(scene: bpy.types.Scene, resolution: int = 64) -> None:
    """Make Cycles unbiased, and give RayBatch the same filter and bounces; the world is black."""
    render, cycles, ours = scene.render, scene.cycles, scene.raybatch
    render.resolution_x = render.resolution_y = resolution
    image = render.image_settings
    image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGB", "32", "ZIP"
    cycles.device, cycles.use_denoising, cycles.use_adaptive_sampling = "CPU", False, False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = cycles.blur_glossy = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 1.5
    ours.pixel_filter, ours.filter_width = "BLACKMAN_HARRIS", 1.5
    set_bounces(scene, BOUNCES)
    add_world(scene, 0.0)


def set_bounces(scene: bpy.types.Scene, count: int) -> None:
    """Limit the bounces of every kind, also through transparent surfaces, for both engines."""
    for name in ("max", "diffuse", "glossy", "transmission", "volume", "transparent_max"):
        setattr(scene.cycles, f"{name}_bounces", count)
    scene.raybatch.bounce_max = scene.raybatch.transparent_bounce_max = count


def add_world(scene: bpy.types.Scene, strength: float, color=(1, 1, 1)) -> bpy.types.World:
    """A new world of one colour; returns it."""
    scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        scene.world.use_nodes = True
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*color, 1)
    background.inputs["Strength"].default_value = strength
    return scene.world


# --- the engines


def over_grey(pixels: np.ndarray) -> np.ndarray:
    """Colours [..., 3] of pixels with alpha, or of pixels without."""
    return pixels[..., :3] + GREY * (1 - pixels[..., 3:]) if pixels.shape[-1] == 4 else pixels


def by_raybatch(
    scene: bpy.types.Scene, seed: int, samples: int, shows: str = "Combined"
) -> tuple[np.ndarray, list[str]]:
    """Pixels of the pass `shows`, and warnings, of a render by RayBatch. Raises `RenderFailed`."""
    films = []

    def listen(_layer, _scene, film):
        films.append(film)

    scene.render.engine = "RAYBATCH"
    # Cycles' own too: a difference would be reported as a setting of Cycles that is not used
    scene.raybatch.seed, scene.raybatch.sample_count, scene.cycles.samples = seed, samples, samples
    frame.film_listeners.append(listen)
    try:
        bpy.ops.render.render()
    except RuntimeError as error:
        raise RenderFailed(" ".join(str(error).split())) from None
    finally:
        frame.film_listeners.remove(listen)
    (film,) = films
    if invalid := film.statistics["invalid_samples"]:
        raise RenderFailed(f"{invalid} samples were not finite")
    pixels = film.passes[shows].astype(float)
    return over_grey(pixels) if scene.render.film_transparent else pixels[..., :3], list(reports.last().warnings)


def by_cycles(scene: bpy.types.Scene, seed: int, samples: int, path: Path, shows: str = "Combined") -> np.ndarray:
    """Pixels of the pass `shows` of a render by Cycles, through an EXR file at `path`."""
    image = scene.render.image_settings
    if shows != "Combined":
        image.media_type, image.file_format = "MULTI_LAYER_IMAGE", "OPEN_EXR_MULTILAYER"
    elif scene.render.film_transparent:
        image.color_mode = "RGBA"
    scene.render.engine, scene.render.filepath = "CYCLES", str(path)
    scene.cycles.seed, scene.cycles.samples = seed, samples
    bpy.ops.render.render(write_still=True)
    if shows != "Combined":
        return page_of(path, shows)
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    width, height = image.size
    pixels = pixels.reshape(height, width, -1).astype(float)
    bpy.data.images.remove(image)
    return over_grey(pixels) if scene.render.film_transparent else pixels[..., :3]


def page_of(path: Path, shows: str) -> np.ndarray:
    """The pass `shows`, of colours, of a multilayer file, bottom row first."""
    import OpenEXR

    for part in OpenEXR.File(str(path), separate_channels=True).parts:
        channels = [part.channels.get(f"ViewLayer.{shows}.{letter}") for letter in "RGB"]
        if None not in channels:
            return np.stack([each.pixels for each in channels], axis=-1)[::-1].astype(float)
    raise RenderFailed(f"Cycles has not written the pass {shows}")


def raybatch_picture(scene: bpy.types.Scene, samples: int, seeds=(1, 2), shows: str = "Combined") -> Picture:
    """Two renders by RayBatch of `samples` each, of the pass `shows`."""
    (first, warnings), (second, _) = (by_raybatch(scene, seed, samples, shows) for seed in seeds)
    return Picture(first, second, warnings)


def cycles_picture(
    scene: bpy.types.Scene, samples: int, folder: Path, seeds=(3, 4), shows: str = "Combined"
) -> Picture:
    """Two renders by Cycles of `samples` each, of the pass `shows`."""
    return Picture(*(by_cycles(scene, seed, samples, folder / f"{seed}.exr", shows) for seed in seeds))


def both_reopened(folder: Path, samples: int, cycles_samples: int | None = None) -> tuple[Picture, Picture]:
    """The current scene, saved and opened again, by RayBatch and by Cycles.

    `samples` are those of each of the two renders.
    """
    blend = str(folder / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    bpy.ops.wm.open_mainfile(filepath=blend)
    scene = bpy.context.scene
    return raybatch_picture(scene, samples), cycles_picture(scene, cycles_samples or samples, folder)
