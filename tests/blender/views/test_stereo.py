"""Stereoscopy: each view is rendered from its own eye, as Cycles does."""

from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import frame  # noqa: E402
from tests.blender.features.compare import empty_scene, set_alike  # noqa: E402
from tests.blender.features.families.cameras import surroundings  # noqa: E402

SAMPLES = 64


def by_cycles(scene, folder: Path) -> list[np.ndarray]:
    """Both eyes' pixels, through files of their own."""
    scene.render.engine, scene.render.filepath = "CYCLES", str(folder / "seen.exr")
    scene.cycles.samples = SAMPLES
    scene.render.image_settings.views_format = "INDIVIDUAL"
    bpy.ops.render.render(write_still=True)
    pictures = []
    for eye in "LR":
        image = bpy.data.images.load(str(folder / f"seen_{eye}.exr"))
        image.colorspace_settings.name = "Non-Color"
        pixels = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(pixels)
        pictures.append(pixels.reshape(image.size[1], image.size[0], -1)[..., :3])
    return pictures


def by_raybatch(scene) -> list[np.ndarray]:
    films = []

    def listen(_layer, _scene, film):
        films.append(film.passes["Combined"][..., :3])

    scene.render.engine, scene.raybatch.sample_count = "RAYBATCH", SAMPLES
    frame.film_listeners.append(listen)
    try:
        bpy.ops.render.render()
    finally:
        frame.film_listeners.remove(listen)
    return films


OTHERS = [("PERSP", "TOE"), ("PANO", "PARALLEL"), ("PANO", "TOE")]


@pytest.mark.parametrize(
    "kind, mode", [("PERSP", "OFFAXIS"), *(pytest.param(*other, marks=pytest.mark.thorough) for other in OTHERS)]
)
def test_both_eyes_see_what_they_see_in_cycles(addon, tmp_path, kind, mode):
    scene = empty_scene()
    set_alike(scene, 32)
    camera = surroundings(scene)
    camera.type = kind
    scene.render.use_multiview = True
    stereo = camera.stereo
    stereo.convergence_mode, stereo.interocular_distance, stereo.convergence_distance = mode, 0.4, 1.5
    if kind == "PANO":
        settings = camera if hasattr(camera, "panorama_type") else camera.cycles
        settings.panorama_type = "EQUIRECTANGULAR"
        stereo.use_spherical_stereo = stereo.use_pole_merge = True
    ours, theirs = by_raybatch(scene), by_cycles(scene, tmp_path)
    assert len(ours) == 2
    apart = np.abs(theirs[0] - theirs[1]).mean()
    for mine, other in zip(ours, theirs):
        assert np.abs(mine - other).mean() < 0.1 * apart
