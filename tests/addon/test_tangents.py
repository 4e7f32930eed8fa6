"""Corners that are one corner of the mesh are found whatever their keys are."""

import numpy as np
import pytest

from raybatch_addon.export.meshes import tangents


def corners(seed: int) -> list[np.ndarray]:
    """Positions, normals and UVs at the corners of 200 triangles that share vertices; some have 0 and -0 alike."""
    rng = np.random.default_rng(seed)
    triangles = rng.integers(0, 90, size=(200, 3))
    found = [rng.integers(-3, 4, size=(90, width)).astype(np.float32)[triangles] for width in (3, 3, 2)]
    return [np.where((each == 0) & (rng.random(each.shape) < 0.5), np.float32(-0.0), each) for each in found]


@pytest.mark.parametrize("seed", range(3))
def test_corners_have_one_number_where_all_values_are_equal(seed):
    found = corners(seed)
    rows = np.concatenate(found, 2).reshape(-1, 8)
    number = tangents._welded(*found).ravel()
    assert len(np.unique(number)) == len(np.unique(rows + 0, axis=0)) < len(rows)
    assert ((number[:, None] == number) == (rows[:, None] == rows).all(2)).all()


@pytest.mark.parametrize("mix", [0, 1, 2**40])
def test_keys_that_fall_together_change_nothing(monkeypatch, mix):
    found = corners(5)
    expected = tangents.corner_tangents(*found)
    monkeypatch.setattr(tangents, "_MIX", np.uint64(mix))
    assert tangents.corner_tangents(*found).tobytes() == expected.tobytes()


def test_a_mesh_without_triangles_has_no_tangents():
    assert tangents.corner_tangents(*(np.zeros((0, 3, width), np.float32) for width in (3, 3, 2))).shape == (0, 3, 4)
