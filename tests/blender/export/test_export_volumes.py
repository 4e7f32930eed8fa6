"""Volume objects: grids as the file has them, and files that cannot be read."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.export.meshes.volumes import export_volume  # noqa: E402
from tests.support.blender_builders import add_object  # noqa: E402


def _openvdb():
    bpy.utils.expose_bundled_modules()
    return pytest.importorskip("openvdb")


def _volume(path):
    data = bpy.data.volumes.new("Smoke")
    data.filepath = str(path)
    return add_object("Smoke", data)


@pytest.fixture
def grid_file(tmp_path):
    """A file of a grid of floats and one of whole numbers; returns its path and the floats."""
    openvdb = _openvdb()
    values = np.random.default_rng(1).random((5, 6, 7), np.float32)
    density, number = openvdb.FloatGrid(), openvdb.Int32Grid()
    density.name, number.name = "density", "number"
    density.copyFromArray(values, ijk=(-2, 3, 1))
    number.copyFromArray(np.ones((2, 2, 2), np.int32))
    density.transform = openvdb.createLinearTransform([[0.5, 0, 0, 0], [0, 0.25, 0, 0], [0, 0, 1, 0], [1, 2, 3, 1]])
    path = tmp_path / "grids.vdb"
    openvdb.write(str(path), [density, number])
    return path, values


def test_a_grid_has_the_values_and_the_place_of_its_file(scene, grid_file):
    path, values = grid_file
    warnings = []
    mesh = export_volume(_volume(path), ["density"], warnings)
    (grid,) = mesh.grids
    assert not warnings and np.array_equal(grid.values, values)
    place = np.array([-2 * 0.5 + 1, 3 * 0.25 + 2, 1 * 1 + 3])  # of the first value
    assert np.allclose(grid.to_index[:, :3] @ place + grid.to_index[:, 3], 0, atol=1e-6)
    step = np.array([0.5, 0.25, 1.0])
    assert np.allclose(mesh.positions.min(0), place - step) and np.allclose(
        mesh.positions.max(0), place + step * (5, 6, 7)
    )


def test_what_cannot_be_read_is_said_by_name(scene, grid_file, tmp_path):
    path, _ = grid_file
    cut = tmp_path / "cut.vdb"
    cut.write_bytes(path.read_bytes()[:200])
    for source, names, word in (
        (tmp_path / "missing.vdb", ["density"], "missing.vdb"),
        (cut, ["density"], "cut.vdb"),
        (path, ["number"], "int32"),
        (path, ["heat"], "“heat”"),
    ):
        warnings = []
        assert export_volume(_volume(source), names, warnings) is None
        assert len(warnings) == 1 and "Smoke" in warnings[0] and word in warnings[0], (source, warnings)
