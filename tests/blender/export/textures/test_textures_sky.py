"""Sky textures against Cycles, direction by direction: the whole sky on a surface, and the sun's disc in a world."""

import math
from pathlib import Path

import numpy as np
import pytest
import warp as wp

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.op import NodeData
from raybatch_addon.core.programs.point import ShadingPoint
from raybatch_addon.core.programs.run import make_run
from raybatch_addon.core.programs.table import encode
from raybatch_addon.core.scene.program import program_features
from raybatch_addon.core.shading.bsdf.materials import ClosureRecord
from raybatch_addon.core.shading.images.image_upload import ImageCache
from raybatch_addon.core.sky.atmosphere import sun_direction, wrapped_sun
from raybatch_addon.core.wavefront.stages.emitted import emission_of
from raybatch_addon.export.nodes.collections import Collections
from raybatch_addon.export.nodes.compile import compile_graph
from raybatch_addon.export.world import export_world
from tests.blender.features.build import world_graph
from tests.blender.features.compare import by_cycles, empty_scene, set_alike, set_bounces
from tests.blender.features.sheet import TOLERANCE
from tests.support.blender_builders import node_tree
from tests.support.cycles_points import COUNT, EDGE, CyclesPoints
from tests.support.running.shares import each_of
from tests.support.under_test import DEVICE

# Preetham's formula is for turbidities from 2 on; below 1.2 it grows without bounds at the horizon
FORMULAS = [
    ((0.0, 0.0, 1.0), 2.2, 0.3),
    ((0.5, 0.3, 0.4), 3.7, 0.0),
    ((-0.5, 0.9, 0.1), 10.0, 0.8),
    ((1.0, 0.0, 0.0), 2.0, 1.0),
]
SCATTERING = ["SINGLE_SCATTERING", "MULTIPLE_SCATTERING"]
ATMOSPHERES = {
    "default": {},
    "high": {
        "sun_elevation": 0.8,
        "sun_rotation": 2.0,
        "altitude": 2000.0,
        "aerosol_density": 2.0,
        "sun_size": 0.3,
        "sun_intensity": 0.5,
    },
    "over the zenith": {
        "sun_elevation": 1.9,
        "sun_rotation": -1.0,
        "altitude": 0.0,
        "air_density": 0.5,
        "aerosol_density": 0.3,
        "ozone_density": 3.0,
        "sun_size": 0.05,
    },
    "set": {"sun_elevation": -0.05, "sun_rotation": 9.0, "sun_size": 0.15},
    "smallest sun": {"sun_elevation": 0.01, "altitude": 100000.0, "sun_size": 0.0},
}


@pytest.fixture(scope="module")
def version(addon):
    if bpy.app.version < (5, 2):
        pytest.skip("the skies are those of Blender 5.2")


@pytest.fixture(scope="module")
def points(version):
    return CyclesPoints()


def directions():
    drawn = np.random.default_rng(30).normal(size=(COUNT, 3))
    return (drawn / np.linalg.norm(drawn, axis=1)[:, None]).astype(np.float32)


def evaluate(socket, owner, looked):
    """Emission of the graph of `socket` in the directions `looked`, [n, 3], as a world."""
    collections = Collections()
    compiled = compile_graph(socket, owner, collections)
    assert not compiled.notes
    features = program_features([compiled.program])
    run = make_run(features)
    registers, records = features.register_count, features.closure_count

    @wp.kernel(**KERNEL_OPTIONS)
    def emit(data: NodeData, looked: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.vec3)):
        i = wp.tid()
        point = ShadingPoint()
        point.incoming = -looked[i]
        point.instance = -1
        stack = wp.zeros(registers, dtype=float)
        closures = wp.zeros(records, dtype=ClosureRecord)
        out[i] = emission_of(closures, run(data, stack, 0, point, closures))

    images = ImageCache().upload(collections.images, DEVICE)
    code, constants, _ = encode([compiled.program], features.ops)
    data = NodeData()
    data.code = wp.array(code, dtype=int, device=DEVICE)
    data.constants = wp.array(constants, dtype=float, device=DEVICE)
    data.images = images.table
    out = wp.zeros(len(looked), dtype=wp.vec3, device=DEVICE)
    wp.launch(emit, len(looked), [data, wp.array(looked, dtype=wp.vec3, device=DEVICE), out], device=DEVICE)
    return out.numpy()


def on_surface(looked, **properties):
    """The sky by RayBatch, on a surface whose coordinates are directions."""
    material = bpy.data.materials.new("Sky")
    tree, surface = node_tree(material)
    sky = _sky(tree, properties)
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    tree.links.new(coordinates.outputs["Object"], sky.inputs["Vector"])
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(sky.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], surface)
    return evaluate(surface, material, looked)


def _sky(tree, properties):
    sky = tree.nodes.new("ShaderNodeTexSky")
    for name, value in properties.items():
        setattr(sky, name, value)
    return sky


def assert_same(found, expected):
    error = np.abs(found.astype(float) - expected) / np.maximum(1, np.abs(expected))
    assert error.max() <= TOLERANCE, f"{error.max()} at point {error.max(1).argmax()}"
    assert np.ptp(expected) > 0


@pytest.mark.parametrize("sun, turbidity, albedo", FORMULAS)
@pytest.mark.parametrize("kind", ["PREETHAM", "HOSEK_WILKIE"])
def test_formulas(points, kind, sun, turbidity, albedo):
    looked = directions()
    properties = {"sky_type": kind, "sun_direction": sun, "turbidity": turbidity, "ground_albedo": albedo}
    assert_same(
        on_surface(looked, **properties), points.values("ShaderNodeTexSky", {"Vector": looked}, "Color", **properties)
    )


@pytest.mark.parametrize("name", each_of(2, ATMOSPHERES))
@pytest.mark.parametrize("kind", SCATTERING)
def test_skies_without_the_sun(points, kind, name):
    looked = directions()
    properties = {"sky_type": kind, "sun_disc": False} | ATMOSPHERES[name]
    assert_same(
        on_surface(looked, **properties), points.values("ShaderNodeTexSky", {"Vector": looked}, "Color", **properties)
    )


def ops_with(sun_disc, kind):
    """Names of the ops of a surface that shows the sky of object coordinates."""
    material = bpy.data.materials.new("Sky")
    tree, surface = node_tree(material)
    sky = _sky(tree, {"sky_type": kind})
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Object"], sky.inputs[0])
    sky.sun_disc = sun_disc
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(sky.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], surface)
    return {step.op for step in compile_graph(surface, material, Collections()).program.instructions}


@pytest.mark.parametrize("kind", [*SCATTERING, "PREETHAM"])
def test_with_the_suns_disc_there_is_no_input(version, kind):
    assert "object_coordinates" in ops_with(False, kind)
    assert ("generated" in ops_with(True, kind)) == (kind in SCATTERING)


def test_an_earlier_sky_is_reported(addon):
    if bpy.app.version >= (5, 0):
        pytest.skip("there is none any more")
    material = bpy.data.materials.new("Sky")
    tree, surface = node_tree(material)
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(_sky(tree, {"sky_type": "NISHITA", "dust_density": 2.0}).outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], surface)
    compiled = compile_graph(surface, material, Collections())
    assert "single scattering" in compiled.notes[0]
    assert any(step.op == "sky_scattering" for step in compiled.program.instructions)


def in_world(build, window, path):
    """The sky by Cycles, [COUNT, 3], as a world that `build(graph)` shades.

    The camera sees equal steps of longitude and latitude.
    """
    scene = empty_scene()
    set_alike(scene, EDGE)
    set_bounces(scene, 0)
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    camera = scene.camera
    camera.rotation_euler = (math.pi / 2, 0, 0)
    camera.data.type, camera.data.panorama_type = "PANO", "EQUIRECTANGULAR"
    camera.data.longitude_min, camera.data.longitude_max, camera.data.latitude_min, camera.data.latitude_max = window
    world = world_graph(scene, build)
    world.cycles.sampling_method = "NONE"
    pixels = by_cycles(scene, 0, 1, path).reshape(COUNT, 3).astype(np.float32)
    return pixels, world


@pytest.mark.parametrize("name", each_of(3, ATMOSPHERES))
@pytest.mark.parametrize("kind", SCATTERING)
def test_worlds_see_the_sun(version, kind, name, tmp_path):
    properties = {"sky_type": kind} | ATMOSPHERES[name]
    elevation, azimuth = wrapped_sun(
        properties.get("sun_elevation", math.radians(15)), properties.get("sun_rotation", 0.0)
    )
    x, y, _ = sun_direction(elevation, azimuth)
    around, half = math.atan2(x, y), 0.6 * max(properties.get("sun_size", 0.00951), 0.0005)
    window = (
        max(around - half, -math.pi),
        min(around + half, math.pi),
        max(elevation - half, -1.57),
        min(elevation + half, 1.57),
    )
    looked, _ = in_world(
        lambda graph: graph.value("ShaderNodeBackground", {"Color": graph.value("ShaderNodeTexCoord")}),
        window,
        _exr(tmp_path),
    )

    def build(graph):
        return graph.value("ShaderNodeBackground", {"Color": graph.value("ShaderNodeTexSky", None, **properties)})

    expected, world = in_world(build, window, _exr(tmp_path))
    assert_same(evaluate(world.node_tree.get_output_node("ALL").inputs["Surface"], world, looked), expected)


def world_under(*suns):
    """A world whose skies have `suns` (size and elevation of each)."""

    def build(graph):
        skies = [graph.value("ShaderNodeTexSky", None, sun_size=size, sun_elevation=up) for size, up in suns]
        color = skies[0]
        for other in skies[1:]:
            color = graph.value("ShaderNodeMixRGB", {"Color1": color, "Color2": other})
        return graph.value("ShaderNodeBackground", {"Color": color})

    world = world_graph(empty_scene(), build)
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 256
    return world


@pytest.mark.parametrize("size", [0.00951, 0.0, 0.5])
def test_the_sun_of_a_world_is_aimed_at(version, size):
    found = export_world(world_under((size, 0.6)), [])
    assert found.sampling_size == 256
    assert found.sun.size == pytest.approx(max(size, 0.0005))
    np.testing.assert_allclose(found.sun.direction, sun_direction(*wrapped_sun(0.6, 0.0)), atol=1e-6)
    assert export_world(world_under((size, 0.6), (size, 0.6)), []).sun == found.sun


@pytest.mark.parametrize("size, width", [(0.00951, 1322), (0.0, 2048), (0.5, 256)])
def test_worlds_are_sampled_finely_enough_for_suns_that_are_not_aimed_at(version, size, width):
    """One whose place depends on a mapping, or several."""
    world = world_under((size, 0.6))
    next(node for node in world.node_tree.nodes if node.type == "TEX_SKY").texture_mapping.rotation[2] = 1.0
    found = export_world(world, [])
    assert found.sun is None and found.sampling_size == pytest.approx(width, abs=1)
    found = export_world(world_under((size, 0.6), (max(size, 0.1), 0.5)), [])
    assert found.sun is None and found.sampling_size == pytest.approx(width, abs=1)


def _exr(folder: Path) -> Path:
    return folder / "sky.exr"
