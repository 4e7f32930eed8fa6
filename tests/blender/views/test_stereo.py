"""Stereoscopy: each view is rendered from its own eye, as Cycles does."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import frame
from tests.blender.features.compare import empty_scene, set_alike
from tests.blender.features.families.cameras import surroundings
from tests.support.scripts_here import call_script

SAMPLES = 64


def saved(scene, engine: str, folder: Path) -> list[np.ndarray]:
    """Both eyes' pixels by `engine`, as Blender saves them in files of their own."""
    scene.render.engine, scene.render.filepath = engine, str(folder / f"{engine}.exr")
    scene.cycles.samples = scene.raybatch.sample_count = SAMPLES
    scene.render.image_settings.views_format = "INDIVIDUAL"
    bpy.ops.render.render(write_still=True)
    pictures = []
    for eye in "LR":
        (part,) = OpenEXR.File(str(folder / f"{engine}_{eye}.exr"), separate_channels=True).parts
        pictures.append(np.stack([part.channels[channel].pixels for channel in "RGB"], -1))
    return pictures


def test_films_of_all_layers_and_eyes_are_kept(scene, tmp_path):
    scene.render.use_multiview = True
    scene.view_layers[0].name = "A"
    scene.view_layers.new("B")
    scene.raybatch.sample_count, scene.render.resolution_percentage = 1, 25
    path, film = tmp_path / "eyes.blend", tmp_path / "eyes.npz"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    done = call_script("render.py", path, "--film", film, "--json", tmp_path / "eyes.json")
    assert done.returncode == 0, done.stderr
    with np.load(film) as passes:
        assert set(passes.files) == {"Combined", "A/right/Combined", "B/left/Combined", "B/right/Combined"}
    reported = [each["frame"] for each in json.loads((tmp_path / "eyes.json").read_text())]
    assert [(each["view_layer"], each["view"]) for each in reported] == [
        (a, b) for a in "AB" for b in ("left", "right")
    ]


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
    views = []
    frame.film_listeners.append(lambda _layer, _scene, film: views.append(film.statistics["frame"]["view"]))
    try:
        ours = saved(scene, "RAYBATCH", tmp_path)
    finally:
        frame.film_listeners.pop()
    assert views == ["left", "right"]
    theirs = saved(scene, "CYCLES", tmp_path)
    apart = np.abs(theirs[0] - theirs[1]).mean()
    for mine, other in zip(ours, theirs):
        assert np.abs(mine - other).mean() < 0.1 * apart
