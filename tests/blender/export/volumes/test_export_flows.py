"""Grids of velocities: how far what a volume object holds moves while the shutter is open."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.shading.volumes.grids import tiles_of
from raybatch_addon.export.meshes.volumes import export_volume
from raybatch_addon.export.motion.shutter import Exposure
from raybatch_addon.export.view import View
from tests.support.blender_builders import add_object, exported, material_of, node_tree

VECTOR = np.array([1.0, -2.0, 0.5])
STEP = 0.25  # of a voxel [m]


def _openvdb():
    bpy.utils.expose_bundled_modules()
    return pytest.importorskip("openvdb")


def exposure(position: str = "CENTER", length: float = 0.5) -> Exposure:
    middle = {"START": 10 + length / 2, "CENTER": 10.0, "END": 10 - length / 2}[position]
    return Exposure(View(), 10.0, middle, length, 24.0)


def smoke(tmp_path, names: tuple[str, ...]) -> bpy.types.Object:
    """A block of 6 x 6 x 6 voxels, which all move by `VECTOR`: in one grid, or in three whose first voxels differ."""
    openvdb = _openvdb()
    density = openvdb.FloatGrid()
    density.name = "density"
    density.copyFromArray(np.ones((6, 6, 6), np.float32), ijk=(1, 2, 3))
    grids = [density]
    for axis, name in enumerate(names):
        grid = openvdb.Vec3SGrid() if len(names) == 1 else openvdb.FloatGrid()
        grid.name = name
        first = (1, 2, 3) if len(names) == 1 else (1 - 9 * axis, 2, 3)
        shape = tuple(7 - k for k in first)
        values = np.ones((*shape, 3)) * VECTOR if len(names) == 1 else np.full(shape, VECTOR[axis])
        grid.copyFromArray(values.astype(np.float32), ijk=first)
        grids.append(grid)
    for grid in grids:
        grid.transform = openvdb.createLinearTransform(STEP)
    path = tmp_path / "smoke.vdb"
    openvdb.write(str(path), grids)
    data = bpy.data.volumes.new("Smoke")
    data.filepath = str(path)
    return add_object("Smoke", data)


def made(obj, when: Exposure | None, warnings=None):
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return export_volume(evaluated, ["density"], 10, [] if warnings is None else warnings, when)


def vectors_at(flow, voxel) -> np.ndarray:
    """Of a voxel of the file."""
    index = np.rint(flow.to_index[:, :3] @ (np.array(voxel) * STEP) + flow.to_index[:, 3]).astype(int)
    corners, tiles = tiles_of(flow)
    (tile,) = np.flatnonzero((corners == index - index % 8).all(1))
    return tiles[(tile, *(index % 8))]


@pytest.mark.parametrize(
    "names", [("velocity",), ("vel",), ("velocity_x", "velocity_y", "velocity_z"), ("vx", "vy", "vz")]
)
@pytest.mark.parametrize(("unit", "scale"), [("SECOND", 3.0 * 0.5 / 24), ("FRAME", 3.0)])
def test_vectors_are_those_of_the_time_that_the_shutter_is_open(scene, tmp_path, names, unit, scale):
    obj = smoke(tmp_path, names)
    obj.data.velocity_unit, obj.data.velocity_scale = unit, 3.0
    obj.data.velocity_grid = names[0][: 1 if len(names[0]) == 2 else None].removesuffix("_x")
    mesh, still = made(obj, exposure()), made(obj, None)
    assert mesh.flow_time == 0.5 and [grid.name for grid in mesh.grids] == ["density"]
    for voxel in ((1, 2, 3), (6, 6, 6)):
        np.testing.assert_allclose(vectors_at(mesh.flow, voxel), scale * VECTOR, rtol=1e-6)
    # the box is as large as things come, and textures span the same
    reach = 0.5 * scale * np.abs(VECTOR)
    np.testing.assert_allclose(mesh.positions.max(0), still.positions.max(0) + reach, rtol=1e-6)
    np.testing.assert_allclose(mesh.positions.min(0), still.positions.min(0) - reach, rtol=1e-6)
    assert mesh.texture_space == still.texture_space and still.flow is None


@pytest.mark.parametrize(("position", "length", "time"), [("START", 0.5, 0.0), ("CENTER", 0.5, 0.5), ("END", 1.0, 0.0)])
def test_grids_are_of_the_frame_that_is_open_in_the_middle(scene, tmp_path, position, length, time):
    """With the end of the shutter at the frame that is the one before, as in Cycles."""
    mesh = made(smoke(tmp_path, ("velocity",)), exposure(position, length))
    assert mesh.flow_time == pytest.approx(time)


def test_what_does_not_move_has_no_vectors(scene, tmp_path):
    obj = smoke(tmp_path, ("velocity",))
    obj.data.velocity_scale = 0.0
    assert made(obj, exposure()).flow is None
    obj.data.velocity_scale = 1.0
    obj.data.update_tag()
    assert made(obj, exposure()).flow is not None
    obj.cycles.use_motion_blur = False
    obj.update_tag()
    assert made(obj, exposure()).flow is None
    assert made(smoke(tmp_path, ()), exposure()).flow is None


def test_a_scene_without_motion_blur_reads_none(scene, tmp_path):
    obj = smoke(tmp_path, ("velocity",))
    tree, surface = node_tree(material_of(obj, "Smoke"))
    tree.links.new(tree.nodes.new("ShaderNodeVolumePrincipled").outputs[0], surface.node.inputs["Volume"])
    (mesh,) = exported().meshes
    assert mesh.flow is None and len(mesh.grids) == 1
