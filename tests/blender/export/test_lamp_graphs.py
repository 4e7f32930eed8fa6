"""Graphs of lights against Cycles: compiled programs, messages about unusable files, and inputs of programs."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.programs.table import encode
from raybatch_addon.export.nodes.textures import ies
from raybatch_addon.export.scene import export_scene
from tests.blender.features.build import floor, lamp, look
from tests.blender.features.compare import by_cycles, by_raybatch, set_alike, set_bounces
from tests.blender.features.families.lamps import lamp_graph, profile
from tests.blender.features.images import image_of, pattern


def exported(scene):
    return export_scene(bpy.context.evaluated_depsgraph_get())


def ops_of(light) -> set[str]:
    return {step.op for step in light.program.instructions}


def ies_light(scene, **properties):
    graph, emission = lamp_graph(lamp("SPOT", (0, 0, 2), energy=10.0))
    node = graph.node("ShaderNodeTexIES", **properties)
    graph.set(emission.inputs["Strength"], node.outputs[0])
    return node


def test_a_graph_that_varies_is_a_program(scene):
    light = lamp("AREA", (1, 2, 3), target=(0, 0, 0), energy=10.0, size=2.0)
    light.scale, light.color, light.pass_index = (2, 1, 1), (0.1, 0.2, 0.3, 0.4), 7
    graph, emission = lamp_graph(light)
    node = graph.node("ShaderNodeTexImage")
    node.image = image_of(pattern())
    graph.set(emission.inputs["Color"], node.outputs["Color"])
    lamp("POINT", (0, 0, 1), energy=4 * math.pi)
    result = exported(scene)
    assert not result.warnings and len(result.images) == 1
    constant, varying = sorted(result.lights, key=lambda each: each.program is not None)
    assert (
        constant.program is None and constant.object_transform is None and constant.emission == pytest.approx((1, 1, 1))
    )
    assert {"image", "emission"} <= ops_of(varying)
    np.testing.assert_allclose(varying.object_transform, np.array(light.matrix_world)[:3], rtol=1e-6)
    assert varying.info[:5] == pytest.approx((0.1, 0.2, 0.3, 0.4, 7)) and 0 <= varying.info[5] <= 1


def test_attributes_of_a_lights_object_are_found(scene):
    for number, name in enumerate(("weight", "color", "no such thing")):
        light = lamp("POINT", (number, 0, 1), energy=4 * math.pi)
        light["weight"], light.color = 0.25 + number, (0.1, 0.2, 0.3, 1.0)
        graph, emission = lamp_graph(light)
        node = graph.node("ShaderNodeAttribute", attribute_type="OBJECT", attribute_name=name)
        graph.set(emission.inputs["Color"], node.outputs["Color"])
    result = exported(scene)
    weight, color, missing = result.lights
    assert weight.attributes[0, :3] == pytest.approx([0.25] * 3) and color.attributes[1, :3] == pytest.approx(
        [0.1, 0.2, 0.3]
    )
    assert missing.attributes is None
    assert len(result.warnings) == 1 and "no such thing" in result.warnings[0] and "Point.002" in result.warnings[0]


def test_a_photometric_file_is_part_of_the_program(scene, tmp_path):
    text = profile(asymmetric=True)
    ies_light(scene, mode="INTERNAL").ies = text
    (inside,) = exported(scene).lights
    assert "ies" in ops_of(inside)
    bpy.data.objects.remove(bpy.context.scene.objects["Spot"])
    path = tmp_path / "Lämp.ies"
    path.write_text(text.as_string())
    ies_light(scene, mode="EXTERNAL").filepath = str(path)
    result = exported(scene)
    assert not result.warnings
    np.testing.assert_array_equal(result.lights[0].program.constants, inside.program.constants)


def test_lamps_of_one_light_share_its_program(scene, tmp_path, monkeypatch):
    path = tmp_path / "Lamp.ies"
    path.write_text(profile(asymmetric=True).as_string())
    node = ies_light(scene, mode="EXTERNAL")
    node.filepath = str(path)
    graph, emission = lamp_graph(first := bpy.context.scene.objects["Spot"])
    lamps = [first] + [bpy.data.objects.new("Spot", first.data) for _ in range(49)]
    for number, light in enumerate(lamps):
        light.location, light.pass_index, light["gain"] = (
            (number % 10 - 4.5, number // 10 - 2, 1.5),
            number,
            0.02 * (number + 1),
        )
        light.rotation_euler = (0.01 * number, 0, 0.1 * number)
        if light is not first:
            scene.collection.objects.link(light)
    gain = graph.node("ShaderNodeAttribute", attribute_type="OBJECT", attribute_name="gain")
    graph.set(emission.inputs["Color"], gain.outputs["Color"])
    parsed, parse = [], ies.parse_profile
    monkeypatch.setattr(ies, "parse_profile", lambda text: parsed.append(text) or parse(text))
    result = exported(scene)
    assert len(parsed) == 1 and len(result.lights) == 50 and not result.warnings
    assert len({id(light.program) for light in result.lights}) == 1
    # attributes of objects stay those of the objects
    assert (
        sorted(light.info[4] for light in result.lights) == list(range(50))
        and len({light.info[5] for light in result.lights}) == 50
    )
    for light in result.lights:
        assert light.attributes[0, 0] == pytest.approx(0.02 * (light.info[4] + 1))
        np.testing.assert_allclose(
            light.object_transform, np.array(lamps[int(light.info[4])].matrix_world)[:3], rtol=1e-6
        )
    programs = [light.program for light in result.lights]
    code, constants, begin = encode([None, *programs, None], ops := tuple(sorted(ops_of(result.lights[0]))))
    alone, its_constants, _ = encode(programs[:1], ops)
    assert (
        np.array_equal(code, alone)
        and np.array_equal(constants, its_constants)
        and begin.tolist() == [-1, *[0] * 50, -1]
    )

    set_alike(scene, 12)
    set_bounces(scene, 0)
    floor()
    look(scene, (0, -2, 9), (0, 0, 0))
    shared, _ = by_raybatch(scene, 4, 1)
    for light in lamps[1:]:
        light.data = light.data.copy()
    apart = exported(scene).lights
    assert len({id(light.program) for light in apart}) == 50
    assert shared.max() > 0 and np.array_equal(shared, by_raybatch(scene, 4, 1)[0])


@pytest.mark.parametrize(
    "name, said",
    (
        ("", "its file cannot be used (none is chosen)"),
        ("gone.ies", "gone.ies” cannot be used (No such file or directory)"),
        ("bad.ies", "TILT="),
    ),
)
def test_a_file_that_cannot_be_used_is_named(scene, tmp_path, name, said):
    (tmp_path / "bad.ies").write_text("no photometry")
    ies_light(scene, mode="EXTERNAL").filepath = str(tmp_path / name) if name else ""
    result = exported(scene)
    (warning,) = result.warnings
    assert warning.startswith("light “Spot”: node “IES Texture”") and said in warning
    # as in Cycles it gives 100 everywhere, and needs no program
    (light,) = result.lights
    assert light.program is None and light.emission == pytest.approx((100 * 10 / (4 * math.pi),) * 3, rel=1e-6)


def test_text_that_cannot_be_used_is_named(scene):
    node = ies_light(scene, mode="INTERNAL")
    assert "its text cannot be used (none is chosen)" in exported(scene).warnings[0]
    node.ies = bpy.data.texts.new("Notizen")
    assert "its text “Notizen” cannot be used" in exported(scene).warnings[0]


OUTPUTS = (
    ("ShaderNodeNewGeometry", "Position", 0.1),
    ("ShaderNodeNewGeometry", "Normal", 0.1),
    ("ShaderNodeNewGeometry", "Incoming", 0.1),
    ("ShaderNodeNewGeometry", "Parametric", 0.5),
    ("ShaderNodeNewGeometry", "Backfacing", 0.5),
    ("ShaderNodeTexCoord", "Generated", 0.1),
    ("ShaderNodeTexCoord", "Normal", 0.1),
    ("ShaderNodeTexCoord", "UV", 0.5),
    ("ShaderNodeTexCoord", "Object", 0.1),
    ("ShaderNodeTexCoord", "Camera", 0.1),
    ("ShaderNodeTexCoord", "Window", 0.2),
    ("ShaderNodeTexCoord", "Reflection", 0.1),
    ("ShaderNodeObjectInfo", "Location", 0.1),
    ("ShaderNodeObjectInfo", "Color", 0.5),
    ("ShaderNodeObjectInfo", "Alpha", 0.5),
    ("ShaderNodeObjectInfo", "Object Index", 0.1),
    ("ShaderNodeObjectInfo", "Random", 0.5),
    ("ShaderNodeLightPath", "Is Shadow Ray", 0.5),
    ("ShaderNodeLightPath", "Ray Depth", 0.5),
    ("ShaderNodeLightFalloff", "Linear", 0.1),
    ("ShaderNodeLayerWeight", "Facing", 0.5),
)


def test_programs_have_the_inputs_of_cycles(scene, tmp_path):
    set_alike(scene, 12)
    set_bounces(scene, 0)
    scene.cycles.filter_width = scene.raybatch.filter_width = 0.01
    floor()
    look(scene, (0, -2, 3), (0, 0, 0), lens=80)
    weights, lights = {}, []
    shapes = (("POINT", {}), ("SPOT", {"spot_size": 2.5}), ("SUN", {}), ("AREA", {"spread": 0.0, "size": 4.0}))
    for kind, values in shapes:  # all without a size, or of one direction: one sample is exact
        light = lamp(kind, (0.4, -0.3, 1.7), target=(0.1, 0.2, 0), energy=0.0, **values)
        if kind in ("POINT", "SPOT"):
            light.data.shadow_soft_size = 0.0
        elif kind == "SUN":
            light.data.angle = 0.0
        light.scale, light.color, light.pass_index = (1.3, 0.8, 1.1), (0.2, 0.5, 0.7, 0.6), 3
        light.rotation_euler.rotate_axis("Z", 0.7)
        graph, emission = lamp_graph(light)
        total = (1.0, 1.0, 1.0)
        for number, (node, output, _) in enumerate(OUTPUTS):
            weight = graph.node("ShaderNodeCombineXYZ")
            weights[light, number] = weight
            total = graph.vector_math(
                "ADD", total, graph.vector_math("MULTIPLY", graph.value(node, {}, output), weight.outputs[0])
            )
        graph.set(emission.inputs["Color"], total)
        lights.append(light)
    for light in lights:
        light.data.energy = 2.0 if light.data.type == "SUN" else 30.0
        for number, (node, output, scale) in enumerate(OUTPUTS):
            # each alone: weights are values, and compile nothing
            for socket in weights[light, number].inputs:
                socket.default_value = scale
            ours, warnings = by_raybatch(scene, 1, 1)
            theirs = by_cycles(scene, 1, 1, tmp_path / "cycles.exr")
            assert not warnings and theirs.max() > 0
            error = np.abs(ours - theirs) / (theirs + 1e-3)
            assert np.median(error) < 2e-3 and error.max() < 0.05, (light.data.type, node, output)
            for socket in weights[light, number].inputs:
                socket.default_value = 0.0
        light.data.energy = 0.0
