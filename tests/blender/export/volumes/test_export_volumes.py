"""Volume objects: grids as the file has them, and files that cannot be read."""

import io
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.notice import Weight
from raybatch_addon.core.shading.volumes.vdb_header import header_is_whole
from raybatch_addon.export.meshes import volumes
from raybatch_addon.export.meshes.smoke import any_grids
from raybatch_addon.export.meshes.volumes import export_volume
from tests.support.blender_builders import add_object, exported, material_of, node_tree


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


def _values(grid, first, shape) -> np.ndarray:
    """The block of voxels of `shape` from the indices `first` on."""
    size = 8 * np.ceil((grid.corners.max(0) + 8) / 8).astype(int)
    block = np.zeros(size, np.float32)
    for corner, tile in zip(grid.corners.tolist(), grid.values):
        block[tuple(slice(k, k + 8) for k in corner)] = tile
    return block[tuple(slice(k, k + n) for k, n in zip(first, shape))]


def test_a_grid_has_the_values_and_the_place_of_its_file(scene, grid_file):
    path, values = grid_file
    warnings = []
    mesh = export_volume(_volume(path), ["density"], 1, warnings)
    (grid,) = mesh.grids
    place = np.array([-2 * 0.5 + 1, 3 * 0.25 + 2, 1 * 1 + 3])  # of the first value
    first = np.round(grid.to_index[:, :3] @ place + grid.to_index[:, 3], 6)
    assert np.array_equal(first, np.array([-2, 3, 1]) % 8)  # tiles are those of the file
    assert not warnings and np.array_equal(_values(grid, first.astype(int), values.shape), values)
    assert np.count_nonzero(grid.values) == values.size
    step = np.array([0.5, 0.25, 1.0])
    assert np.allclose(mesh.positions.min(0), place - step) and np.allclose(
        mesh.positions.max(0), place + step * (5, 6, 7)
    )


def test_what_cannot_be_read_is_said_by_name(scene, grid_file, tmp_path):
    path, _ = grid_file
    whole = path.read_bytes()
    cut = {size: tmp_path / f"cut {size}.vdb" for size in (50, 200, 210, len(whole) // 3, len(whole) // 2)}
    for size, file in cut.items():  # in the header, in what describes a grid, and in its leaves
        file.write_bytes(whole[:size])
    for source, names, word in (
        (tmp_path / "missing.vdb", ["density"], "missing.vdb"),
        *((file, ["density"], file.name) for file in cut.values()),
        (path, ["number"], "int32"),
        (path, ["heat"], "“heat”"),
    ):
        warnings = []
        obj = _volume(source)
        assert export_volume(obj, names, 1, warnings) is None
        assert warnings[0].weight == Weight.MISSING and warnings[0].objects == (obj.name,)
        assert len(warnings) == 1 and "Smoke" in warnings[0] and word in warnings[0], (source, warnings)


def test_a_good_grid_beside_one_of_an_unknown_type_or_one_that_is_cut_off_is_read(scene, grid_file, tmp_path):
    path, values = grid_file
    cut = tmp_path / "cut.vdb"
    cut.write_bytes(path.read_bytes()[:-400])
    for source, word in ((path, "int32"), (cut, "cut.vdb")):
        warnings = []
        mesh = export_volume(_volume(source), ["density", "number"], 1, warnings)
        assert [grid.name for grid in mesh.grids] == ["density"], source
        assert np.count_nonzero(mesh.grids[0].values) == values.size
        assert len(warnings) == 1 and "“number”" in warnings[0] and word in warnings[0]
        assert warnings[0].weight == Weight.MISSING


def test_only_files_whose_header_is_cut_off_are_refused_by_it(grid_file):
    whole = grid_file[0].read_bytes()
    accepted = [header_is_whole(io.BytesIO(whole[:size]), size) for size in range(len(whole) + 1)]
    first = accepted.index(True)  # behind the description of the first grid
    assert accepted[-1] and 300 < first < 1000 and all(accepted[first : len(whole) // 3])
    assert header_is_whole(io.BytesIO(b"no such file" * 9), 108)


def test_grids_that_are_nearly_empty_are_read_where_there_is_something(scene, tmp_path):
    """Two blocks of values and a tile of one value, 40,000 voxels apart: a block of all would be of 10^14 voxels."""
    openvdb = _openvdb()
    random = np.random.default_rng(2)
    grid = openvdb.FloatGrid()
    grid.name = "density"
    blocks = {place: random.random((20, 9, 30), np.float32) + 0.1 for place in ((-20000, 3, 5), (20001, 40000, 77))}
    for place, values in blocks.items():
        grid.copyFromArray(values, ijk=place)
    grid.fill((0, 0, 0), (127, 127, 127), 2.0)
    openvdb.write(str(tmp_path / "sparse.vdb"), [grid])
    warnings = []
    (found,) = export_volume(_volume(tmp_path / "sparse.vdb"), ["density"], 1, warnings).grids
    assert not warnings
    begin = np.round(-found.to_index[:, 3]).astype(int)  # indices in the file of the first voxel here
    at = {tuple(corner): tile for corner, tile in zip((found.corners + begin).tolist(), found.values)}
    count = 128**3 + sum(values.size for values in blocks.values())
    assert np.count_nonzero(found.values) == count == sum(np.count_nonzero(tile) for tile in at.values())
    for place, values in blocks.items():
        for voxel in random.integers(0, values.shape, (100, 3)):
            index = np.array(place) + voxel
            assert at[tuple((index - index % 8).tolist())][tuple(index % 8)] == values[tuple(voxel)]
    assert at[64, 120, 0].min() == at[64, 120, 0].max() == 2.0


def test_grids_of_too_many_values_are_named(scene, grid_file, monkeypatch):
    monkeypatch.setattr(volumes, "_VALUES_MOST", 4 * 512 - 1)
    warnings = []
    assert export_volume(_volume(grid_file[0]), ["density"], 1, warnings) is None
    assert len(warnings) == 1 and "density" in warnings[0] and "5 x 6 x 7" in warnings[0]


def _made(kind: str, **values) -> bpy.types.NodeTree:
    """Geometry nodes that make a volume by the node `kind`."""
    tree = bpy.data.node_groups.new("Make", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    begin, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    node = tree.nodes.new(kind)
    for name, value in values.items():
        node.inputs[name].default_value = value
    if node.inputs[0].type == "GEOMETRY":
        tree.links.new(begin.outputs[0], node.inputs[0])
    tree.links.new(node.outputs[0], end.inputs[0])
    return tree


@pytest.mark.parametrize(
    "kind, values",
    [
        ("GeometryNodeVolumeCube", {"Density": 2.0, "Resolution X": 8, "Resolution Y": 8, "Resolution Z": 8}),
        ("GeometryNodeMeshToVolume", {"Density": 2.0}),
    ],
)
def test_volumes_that_geometry_nodes_make_have_their_grids(scene, kind, values):
    _openvdb()
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    bpy.context.object.modifiers.new("Make", "NODES").node_group = _made(kind, **values)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert any_grids(depsgraph.objects)
    found, warnings = [], []
    for placed in depsgraph.object_instances:
        if placed.object.type == "VOLUME":
            found.append(export_volume(placed.object, ["density"], 1, warnings))
    assert len(found) == 1 and not warnings
    (grid,) = found[0].grids
    assert grid.name == "density" and 1.9 < grid.values.max() < 2.1
    tile, *voxel = np.nonzero(grid.values)
    place = grid.corners[tile] + np.stack(voxel, 1)
    middle = grid.to_index[:, 3]  # where the object's origin is among the values
    assert np.allclose(middle, 0.5 * (place.min(0) + place.max(0)), atol=1.0)
    around = found[0].positions - found[0].positions.mean(0)  # Blender 4.5 puts the cube half a voxel off
    assert np.abs(around).max() == pytest.approx(1.0, abs=0.4)


def test_smoke_has_its_grids_in_the_box_of_its_domain(scene, tmp_path):
    """The simulation itself needs Blender: its settings are stood in for."""
    shape = (4, 3, 2)
    density = np.random.default_rng(1).random(shape).astype(np.float32)
    colors = np.dstack([density[..., None] * (0.2, 0.4, 0.6)]).astype(np.float32)
    rgba = np.concatenate([colors, density[..., None]], -1)
    mesh = SimpleNamespace(name="Domain", texspace_location=(1.0, 0.0, 0.0), texspace_size=(2.0, 1.5, 1.0))
    domain = SimpleNamespace(
        domain_type="GAS",
        domain_resolution=shape,
        use_noise=False,
        noise_scale=2,
        cache_directory=str(tmp_path),
        cache_frame_start=1,
        cache_frame_offset=0,
        density_grid=_Stored(density.T.ravel()),
        color_grid=_Stored(rgba.transpose(2, 1, 0, 3).ravel()),
        heat_grid=_Stored(np.zeros(24, np.float32)),
    )
    modifier = SimpleNamespace(type="FLUID", fluid_type="DOMAIN", domain_settings=domain)
    obj = SimpleNamespace(name="Smoke", type="MESH", data=mesh, modifiers=[modifier], material_slots=[])
    warnings = []
    assert any_grids([obj])
    made = export_volume(obj, ["density", "color", "heat"], 1, warnings)
    by_name = {grid.name: grid for grid in made.grids}
    assert not warnings and set(by_name) == {"density", "color"} and not made.object_density
    assert np.array_equal(by_name["density"].values, density)
    assert np.allclose(by_name["color"].values, (0.2, 0.4, 0.6), atol=1e-6)
    to_index = by_name["density"].to_index
    # the middle of the first cell, which is 1 m long, wide and high
    assert np.allclose(to_index[:, :3] @ (-0.5, -1.0, -0.5) + to_index[:, 3], 0)
    domain.density_grid[0] = np.inf
    odd = export_volume(obj, ["density"], 1, warnings).grids[0]
    density[0, 0, 0] = 0
    assert np.array_equal(odd.values, density) and len(warnings) == 1 and "1 numbers" in warnings.pop()
    domain.density_grid = _Stored(np.zeros(24, np.float32))
    assert export_volume(obj, ["density"], 1, warnings) is None
    assert len(warnings) == 1 and "Smoke" in warnings[0] and "cache" in warnings[0]
    assert warnings[0].weight == Weight.MISSING
    # before the simulation begins, and in a frame of it that has none yet, there is no smoke and nothing is missing
    warnings.clear()
    assert export_volume(obj, ["density"], 0, warnings) is None and not warnings
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "fluid_data_0001.vdb").touch()
    assert export_volume(obj, ["density"], 1, warnings) is None and not warnings
    assert export_volume(obj, ["density"], 2, warnings) is None and len(warnings) == 1
    assert export_volume(obj, ["fog"], 1, warnings) is None and len(warnings) == 2


class _Stored(list):
    """Numbers that are read as Blender's are."""

    def foreach_get(self, target) -> None:
        target[:] = self


def test_simplify_makes_voxels_larger(scene, tmp_path):
    """As Blender does before Cycles sees them."""
    openvdb = _openvdb()
    density = openvdb.FloatGrid()
    density.name = "density"
    density.copyFromArray(np.random.default_rng(2).random((32, 32, 32), np.float32) + 1)
    openvdb.write(str(tmp_path / "fine.vdb"), [density])
    obj = _volume(tmp_path / "fine.vdb")
    steps, means = [], []
    for factor in (1.0, 0.5, 0.25):
        scene.render.use_simplify, scene.render.simplify_volumes = factor < 1, factor
        placed = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
        warnings = []
        (grid,) = export_volume(placed, ["density"], 1, warnings).grids
        assert not warnings
        steps.append(1 / np.linalg.norm(grid.to_index[:, 0]))
        means.append(grid.values[grid.values > 0].mean())
    np.testing.assert_allclose(steps, [1, 2, 4])
    np.testing.assert_allclose(means, means[0], rtol=0.05)


def test_volumes_of_more_meshes_than_a_ray_notices_are_named_before_a_render(scene):
    for k in range(6):
        bpy.ops.mesh.primitive_cube_add(size=2.0 - 0.1 * k)
        tree, surface = node_tree(material_of(bpy.context.object))
        volume = tree.nodes.new("ShaderNodeVolumeScatter")
        tree.links.new(volume.outputs[0], surface.node.inputs["Volume"])
        said = [each for each in exported().warnings if "overlap" in each]
        assert len(said) == (k > 3), said
    assert len(said[0].objects) == 6 and "“Cube.005”" in said[0] and said[0].weight == Weight.MISSING


@pytest.mark.parametrize("kind", ["FloatGrid", "DoubleGrid"])
def test_voxels_that_are_no_numbers_become_0_and_are_counted(scene, tmp_path, kind):
    """Numbers of float64 that float32 has not are none of it either."""
    openvdb = _openvdb()
    if not hasattr(openvdb, kind):
        pytest.skip(f"this module has no {kind}")
    values = np.ones((4, 4, 4), np.float32 if kind == "FloatGrid" else np.float64)
    values[0, 0, 1:3] = (np.inf, -np.inf if kind == "FloatGrid" else 1e300)
    grid = getattr(openvdb, kind)()
    grid.name = "density"
    grid.copyFromArray(values)
    grid.getAccessor().setValueOn((0, 0, 0), np.nan)
    openvdb.write(str(tmp_path / "odd.vdb"), [grid])
    warnings = []
    (found,) = export_volume(_volume(tmp_path / "odd.vdb"), ["density"], 1, warnings).grids
    assert found.values.sum() == 61 and len(warnings) == 1
    assert "“density”" in warnings[0] and "3 numbers" in warnings[0]
    assert warnings[0].weight == Weight.REPAIRED and warnings[0].objects[0].startswith("Smoke")


def test_grids_that_a_material_reads_by_splines(scene, grid_file):
    """The box goes on by one voxel more, and coordinates span the same."""
    obj = _volume(grid_file[0])
    material = material_of(obj, "Smoke")
    tree, surface = node_tree(material)
    tree.links.new(tree.nodes.new("ShaderNodeVolumePrincipled").outputs[0], surface.node.inputs["Volume"])
    found = {}
    for kind in ("LINEAR", "CUBIC"):
        material.cycles.volume_interpolation = kind
        made = exported()
        ops = {step.op for each in made.materials if each.volume for step in each.volume.program.instructions}
        found[kind] = made.meshes[0], ops & {"volume_attribute", "volume_attribute_cubic"}
    (linear, first), (smooth, second) = found["LINEAR"], found["CUBIC"]
    assert first == {"volume_attribute"} and second == {"volume_attribute_cubic"}
    assert smooth.texture_space == linear.texture_space
    for side in (np.min, np.max):
        reach = np.abs(side(smooth.positions, 0) - side(linear.positions, 0))
        np.testing.assert_allclose(reach, (0.5, 0.25, 1.0), rtol=1e-5)
