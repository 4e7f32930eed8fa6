"""Renders of hair and points: extreme ones are finite, and no schedule changes a bit of them."""

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Frame, Mesh
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

COUNT = 2000


def strands(points, radius) -> Mesh:
    """Straight strands between pairs of points, shape [n, 2, 3]."""
    first = 2 * np.arange(len(points), dtype=np.int32)
    rows = np.stack([first, first + 1, first], 1)
    radii = np.broadcast_to(np.float32(radius), 2 * len(points)).copy()
    return Mesh("strands", np.asarray(points, np.float32).reshape(-1, 3), rows, radii=radii)


def star() -> np.ndarray:
    """Strands through one point."""
    outwards = np.random.default_rng(1).normal(size=(COUNT, 3))
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    return np.stack([-outwards, outwards], 1)


CASES = {
    "through one point": lambda: strands(star(), 0.004),
    "a ten-millionth of a metre thick": lambda: strands(star(), 1e-7),
    "without radius": lambda: strands(star(), 0.0),
    "without length": lambda: strands(np.repeat(star()[:, :1], 2, 1), 0.02),
    "a million metres away": lambda: strands(star() + 1e6, 0.1),
    "thicker than the world": lambda: strands(star(), np.where(np.arange(2 * COUNT) == 7, 1e17, 0.01)),
}


@pytest.mark.thorough  # kernels for curves, batched and not
@pytest.mark.parametrize("name", CASES)
def test_extreme_hair_is_finite_under_any_schedule(name):
    ground = scenes.plane(size=6.0)
    objects = [(CASES[name](), scenes.IDENTITY, scenes.diffuse()), (ground, scenes.IDENTITY, scenes.diffuse(0.5))]
    scene = scenes.scene(objects, frame=Frame(48, 48), lights=[scenes.sun()], world=0.5)
    films = [
        Session("cpu", RenderSettings(sample_count=4, kernel_tier="SPECIALISED", **schedule)).render(scene)
        for schedule in (
            {"batching": "OFF"},
            {"batching": "ON"},
            {"batching": "OFF", "ray_sort": "ON", "tile_size": 16},
        )
    ]
    pictures = [film.passes["Combined"] for film in films]
    assert np.isfinite(pictures[0]).all()
    assert np.array_equal(pictures[0], pictures[1]) and np.array_equal(pictures[0], pictures[2])
