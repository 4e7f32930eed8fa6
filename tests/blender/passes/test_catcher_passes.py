"""Shadow catchers as Blender's files get them."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.blender.features.build import ball, diffuse, floor, lamp, look
from tests.blender.features.compare import add_world, set_alike
from tests.blender.passes import test_passes


def rendered(scene, path) -> dict[str, np.ndarray]:
    """Pages of a file, letters of colours in the order A, B, G, R."""
    return test_passes.rendered(scene, "RAYBATCH", path, 1)


def test_files_have_the_pass_or_shadows_in_alpha(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(test_passes, "SAMPLES", 16)
    set_alike(scene, 24)
    add_world(scene, 0.2)
    scene.render.film_transparent = True
    floor(4.0).is_shadow_catcher = True
    diffuse(ball("Ball", (0, 0, 0.7), 0.7), (0.8, 0.3, 0.2))
    lamp("SUN", (0, 0, 5), target=(2, 0, 0), energy=3.0)
    look(scene, (0, -5, 2.6), (0, 0, 0.5))
    laid = rendered(scene, tmp_path / "laid.exr")
    assert set(laid) == {"Combined"}
    scene.view_layers[0].cycles.use_pass_shadow_catcher = True
    apart = rendered(scene, tmp_path / "apart.exr")
    assert set(apart) == {"Combined", "Shadow Catcher"}
    shown = apart["Shadow Catcher"]
    assert shown.min() < 0.3 and shown[0].min() > 0.9  # the file's first row is the top: no shadow comes there
    # what the pass darkens covers what is behind where it is not asked for
    dark = 1 - np.clip(shown.mean(-1), 0, 1)
    alpha = apart["Combined"][..., 0]
    assert np.allclose(laid["Combined"][..., 0], alpha + (1 - alpha) * dark, atol=1e-5)
    assert np.array_equal(laid["Combined"][..., 1:], apart["Combined"][..., 1:])
    scene.raybatch_export.exposure = 2.0
    brighter = rendered(scene, tmp_path / "brighter.exr")
    assert np.array_equal(brighter["Shadow Catcher"], shown)
    assert np.allclose(brighter["Combined"][..., 1:], 2 * apart["Combined"][..., 1:])
