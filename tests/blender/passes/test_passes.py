"""Passes against Cycles' own of the same .blend, and as files and the compositor get them."""

import json

import numpy as np
import OpenEXR
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.cryptomatte import matte_identity, murmur_hash
from raybatch_addon.core.scene.passes import PASSES
from raybatch_addon.export.passes import LIGHT_PASS_PROPERTIES, MATTE_PROPERTIES, PASS_PROPERTIES, blender_name
from tests.blender.features.build import ball, diffuse, floor, lamp, look, material_graph, principled, shaded
from tests.blender.features.compare import Picture, add_world, figures_of, set_alike

# Names of the film's passes by those that Blender has for them
OF_FILM = {blender_name(name): name for name in PASSES}
ALL = (*PASS_PROPERTIES, *LIGHT_PASS_PROPERTIES, *MATTE_PROPERTIES)
SAMPLES = 200


def pages_of(path) -> dict[str, np.ndarray]:
    """Passes of a multilayer file by the film's names, with their channels in the order of their names."""
    found: dict[str, dict[str, np.ndarray]] = {}
    for part in OpenEXR.File(str(path), separate_channels=True).parts:
        for channel, values in part.channels.items():
            _, name, letter = channel.rsplit(".", 2)
            found.setdefault(OF_FILM.get(name, name), {})[letter] = values.pixels
    return {name: np.stack([each[letter] for letter in sorted(each)], axis=-1) for name, each in found.items()}


def rendered(scene, engine: str, path, seed: int) -> dict[str, np.ndarray]:
    scene.render.engine, scene.render.filepath = engine, str(path)
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR_MULTILAYER", "32"
    scene.cycles.samples = scene.raybatch.sample_count = SAMPLES
    scene.cycles.seed = scene.raybatch.seed = seed
    bpy.ops.render.render(write_still=True)
    return pages_of(path)


def still_life(scene):
    """Balls of all components on a floor, below a lamp, a sun and a pale sky; objects and materials are numbered."""
    set_alike(scene, 32)
    add_world(scene, 0.5, (0.6, 0.75, 1.0))
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=2.0, angle=0.8)
    objects = [
        floor(),
        diffuse(ball("Chalk", (-1.3, 0, 0.5), 0.5), (0.2, 0.3, 0.8)),
        principled(ball("Metal", (-0.1, 0.4, 0.5), 0.5), (0.95, 0.7, 0.3), Metallic=1.0, Roughness=0.25),
        shaded(ball("Glass", (1.1, 0, 0.5), 0.5), "ShaderNodeBsdfGlass", Color=(0.9, 1, 0.95, 1), Roughness=0.0),
        shaded(ball("Bulb", (-0.7, -0.9, 0.25), 0.2), "ShaderNodeEmission", Color=(1, 0.5, 0.2, 1), Strength=3.0),
        material_graph(
            ball("Veil", (0.3, -0.9, 0.35), 0.3),
            lambda graph: graph.value(
                "ShaderNodeMixShader",
                {
                    0: 0.6,
                    1: graph.value("ShaderNodeBsdfDiffuse", {"Color": (0.8, 0.3, 0.2)}),
                    2: graph.value("ShaderNodeBsdfTransparent"),
                },
            ),
        ),
    ]
    for i, obj in enumerate(objects):
        obj.pass_index, obj.active_material.pass_index = i + 1, i + 10
    bpy.context.view_layer.update()
    objects[4].parent = objects[1]
    objects[4].matrix_parent_inverse = objects[1].matrix_world.inverted()
    scene.world.mist_settings.start, scene.world.mist_settings.depth = 2, 6
    scene.world.light_settings.distance = 0.9
    layer = scene.view_layers[0]
    for name, kind in (("hue", "COLOR"), ("amount", "VALUE")):
        aov = layer.aovs.add()
        aov.name, aov.type = name, kind
    tree = objects[1].active_material.node_tree
    hue = tree.nodes.new("ShaderNodeOutputAOV")
    hue.aov_name = "hue"
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], hue.inputs["Color"])
    amount = tree.nodes.new("ShaderNodeOutputAOV")
    amount.aov_name = "amount"
    amount.inputs["Value"].default_value = -2.5
    look(scene, (0, -4.2, 2.0), (0, 0, 0.4), lens=45)
    for prop in ALL:
        setattr(layer, prop, True)


@pytest.fixture(scope="module")
def both(addon, tmp_path_factory):
    """The passes of RayBatch and of Cycles, two renders of each; warnings, and the header of a file."""
    from raybatch_addon.blender import reports
    from tests.blender.features.compare import empty_scene

    scene, folder = empty_scene(), tmp_path_factory.mktemp("passes")
    still_life(scene)
    ours = [rendered(scene, "RAYBATCH", folder / "ours.exr", seed) for seed in (1, 2)]
    warnings = list(reports.last().warnings)
    header = dict(OpenEXR.File(str(folder / "ours.exr"), separate_channels=True).parts[0].header)
    return ours, [rendered(scene, "CYCLES", folder / "theirs.exr", seed) for seed in (3, 4)], warnings, header


def test_names_and_channels_are_those_of_cycles(both):
    (ours, _), (theirs, _), warnings, _ = both
    assert warnings == []
    assert {name: values.shape for name, values in ours.items()} == {
        name: values.shape for name, values in theirs.items()
    }


@pytest.mark.parametrize("name", sorted({*LIGHT_PASS_PROPERTIES.values(), "Mist", "UV", "Normal", "hue", "amount"}))
def test_passes_have_the_means_of_cycles(both, name):
    def picture(renders) -> Picture:
        values = [each[name].astype(float) for each in renders]
        # light is divided by colours that are small at the edges of objects: here it counts as in the picture
        if name.endswith(("Direct", "Indirect")):
            color = name.rsplit(" ", 1)[0] + " Color"
            values = [each * render[color] for each, render in zip(values, renders)]
        return Picture(*values)

    found = figures_of(*(picture(renders) for renders in both[:2]))
    print(name, found.ours, found.theirs, found.noise)
    assert found.mean_error < 0.01 + 3 * min(found.noise, 0.01), name


def test_indices_are_those_of_cycles_where_one_object_fills_a_pixel(both):
    ours, theirs = both[0][0], both[1][0]
    full = np.abs(theirs["CryptoObject00"][..., 2] - 1) < 1e-6  # channels by name: a, b, g, r
    assert full.mean() > 0.4
    for name in ("Object Index", "Material Index"):
        assert np.array_equal(ours[name][full], theirs[name][full]), name
        assert len(np.unique(ours[name][full])) >= 4
    assert ours["Depth"][full] == pytest.approx(theirs["Depth"][full], rel=0.1, abs=0.1)


@pytest.mark.parametrize("kind", MATTE_PROPERTIES.values())
def test_mattes_are_those_of_cycles(both, kind):
    ours, theirs = (
        {
            (y, x, identity): weight
            for level in ("00", "01", "02")
            for pair in ((3, 2), (1, 0))  # r and g, b and a
            for (y, x), identity, weight in zip(
                np.ndindex(32, 32),
                passes[kind + level][..., pair[0]].ravel().view(np.uint32).tolist(),
                passes[kind + level][..., pair[1]].ravel().tolist(),
            )
            if weight > 0
        }
        for passes in (both[0][0], both[1][0])
    )
    assert {key[2] for key in ours} == {key[2] for key in theirs}
    # a sample more or less at an edge; a sixteenth where objects are seen through a veil
    for key in ours.keys() | theirs.keys():
        assert abs(ours.get(key, 0) - theirs.get(key, 0)) < 0.2, key
    names = {"CryptoObject": ("Chalk", "Bulb"), "CryptoMaterial": ("Chalk material",), "CryptoAsset": ("Chalk",)}[kind]
    assert {matte_identity(name) for name in names} <= {key[2] for key in ours}
    assert (matte_identity("Bulb") in {key[2] for key in ours}) == (kind == "CryptoObject")


def test_files_say_what_mattes_stand_for(both):
    header = both[3]
    name = "ViewLayer.CryptoObject"
    prefix = f"cryptomatte/{murmur_hash(name):08x}"[: len("cryptomatte/") + 7]
    assert header[f"{prefix}/name"] == name and header[f"{prefix}/hash"] == "MurmurHash3_32"
    manifest = json.loads(header[f"{prefix}/manifest"])
    assert manifest["Chalk"] == f"{murmur_hash('Chalk'):08x}" and len(manifest) == 6


def test_the_compositor_has_sockets_of_all_passes(both):
    layer = bpy.context.scene.view_layers[0]
    layer.use_pass_mist = layer.use_pass_diffuse_color = layer.use_pass_cryptomatte_object = True
    scene = bpy.context.scene
    if hasattr(scene, "compositing_node_group"):
        tree = scene.compositing_node_group = bpy.data.node_groups.new("Compositing", "CompositorNodeTree")
    else:  # before Blender 5 it has one of its own
        scene.use_nodes = True
        tree = scene.node_tree
    bpy.context.scene.render.engine = "RAYBATCH"
    layer.update_render_passes()
    sockets = {socket.name for socket in tree.nodes.new("CompositorNodeRLayers").outputs if socket.enabled}
    assert {"Mist", blender_name("Diffuse Color"), "hue", "amount"} <= sockets


@pytest.mark.parametrize("way", ["object", "collection"])
def test_holdout_objects_are_holes_for_the_camera_alone(addon, tmp_path, way):
    """A ball is cut out of the picture; its shadow, and its colour on the floor, stay."""
    from tests.blender.features.compare import empty_scene

    scene = empty_scene()
    set_alike(scene, 24)
    add_world(scene, 0.5)
    scene.render.film_transparent = True
    floor()
    made = diffuse(ball("Hole", (0, 0, 0.6), 0.6), (0.9, 0.1, 0.1))
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=2.0, angle=0.2)
    look(scene, (0, -4.2, 2.0), (0, 0, 0.4), lens=45)
    if way == "object":
        made.is_holdout = True
    else:
        hidden = bpy.data.collections.new("Hidden")
        scene.collection.children.link(hidden)
        scene.collection.objects.unlink(made)
        hidden.objects.link(made)
        scene.view_layers[0].layer_collection.children["Hidden"].holdout = True
    ours, theirs = (
        Picture(*(rendered(scene, engine, tmp_path / "hole.exr", seed)["Combined"].astype(float) for seed in seeds))
        for engine, seeds in (("RAYBATCH", (1, 2)), ("CYCLES", (3, 4)))
    )
    found = figures_of(ours, theirs)
    assert found.mean_error < 0.01 and found.rel_mse < 2e-3, found
    assert ours.mean[12, 12].tolist() == [0, 0, 0, 0]  # alpha, blue, green, red


@pytest.mark.parametrize("own", [True, False])
def test_mist_is_that_of_the_scene_s_world_whatever_world_a_view_layer_has(scene, tmp_path, own, general_kernels):
    set_alike(scene, 8)
    floor()
    look(scene, (0, -4.2, 2.0), (0, 0, 0.4), lens=45)
    scene.world = None
    worlds = [bpy.data.worlds.new(name) for name in "AB"]
    for world, depth in zip(worlds, (10.0, 40.0)):
        world.mist_settings.start, world.mist_settings.depth = 0.0, depth
    layer = scene.view_layers[0]
    layer.world_override, layer.use_pass_mist = worlds[1], True
    if own:
        scene.world = worlds[0]
    ours, theirs = (
        rendered(scene, engine, tmp_path / f"{engine}.exr", 1)["Mist"].mean() for engine in ("RAYBATCH", "CYCLES")
    )
    assert ours == pytest.approx(theirs, rel=0.02) and theirs > 0
