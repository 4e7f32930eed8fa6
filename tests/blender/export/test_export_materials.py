"""Shader graphs exported to the core's closures."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.scene.notice import Weight
from raybatch_addon.export.materials import export_material
from raybatch_addon.export.nodes.registry import Handled, shader_nodes
from tests.support.blender_builders import add_object, add_triangle, exported, material_of, node_tree

pytestmark = pytest.mark.usefixtures("scene")

RED, GREEN = (1.0, 0.25, 0.125, 1.0), (0.125, 1.0, 0.25, 1.0)


def new_material(name="Material"):
    """A material whose only node is its output; returns (material, tree, Surface socket)."""
    material = bpy.data.materials.new(name)
    return material, *node_tree(material)


def add_node(tree, kind, **inputs):
    """A node; inputs are named with _ for spaces."""
    node = tree.nodes.new(kind)
    for name, value in inputs.items():
        node.inputs[name.replace("_", " ")].default_value = value
    return node


def of_one(kind, **inputs):
    """The exported material whose surface is one node of type `kind`, and the messages about omissions."""
    material, tree, surface = new_material()
    tree.links.new(add_node(tree, kind, **inputs).outputs[0], surface)
    return export_material(material)


def weights(material):
    """Weights by kind, a metal's times its colour; weights of the same kind are added."""
    totals = {}
    for closure in material.closures:
        weight = np.array(closure.weight) * (closure.color if closure.kind == K.METAL else 1)
        totals[closure.kind] = totals.get(closure.kind, 0) + weight
    return {kind: pytest.approx(total, rel=1e-6) for kind, total in totals.items()}


@pytest.mark.parametrize(
    "node, inputs, kind, weight",
    [
        ("ShaderNodeBsdfDiffuse", {"Color": RED}, K.DIFFUSE, RED),
        ("ShaderNodeBsdfDiffuse", {"Color": (-1, 0.5, 2, 1)}, K.DIFFUSE, (0, 0.5, 2)),
        ("ShaderNodeBsdfAnisotropic", {"Color": RED}, K.GLOSSY, RED),
        ("ShaderNodeBsdfGlass", {"Color": RED}, K.GLASS, RED),
        ("ShaderNodeBsdfTransparent", {"Color": RED}, K.TRANSPARENT, RED),
        ("ShaderNodeEmission", {"Color": RED, "Strength": 4}, K.EMISSION, (4, 1, 0.5)),
        ("ShaderNodeBsdfMetallic", {"Base_Color": RED}, K.METAL, RED),
    ],
)
def test_nodes_of_one_closure(node, inputs, kind, weight):
    material, notes = of_one(node, **inputs)
    assert notes == []
    assert weights(material) == {kind: np.array(weight[:3])}
    assert material.kinds == (kind,)


def test_roughness_and_index_of_refraction():
    glass = of_one("ShaderNodeBsdfGlass", Roughness=0.25, IOR=1.75)[0].closures[0]
    assert (glass.roughness, glass.ior) == (0.25, 1.75)
    glossy = of_one("ShaderNodeBsdfAnisotropic", Roughness=0.375)[0].closures[0]
    assert glossy.roughness == 0.375


def test_the_distribution_says_whether_facets_scatter_more_than_once():
    for distribution, several in (("MULTI_GGX", True), ("GGX", False)):
        material, tree, surface = new_material()
        node = add_node(tree, "ShaderNodeBsdfGlass")
        node.distribution = distribution
        tree.links.new(node.outputs[0], surface)
        assert export_material(material)[0].closures[0].multiscatter == several


def test_values_of_weight_zero_leave_the_kind_but_no_closure():
    material, _ = of_one("ShaderNodeEmission", Strength=0)
    assert material.closures == () and material.kinds == (K.EMISSION,)


def test_mix_weighs_and_add_adds():
    material, tree, surface = new_material()
    mix, add = add_node(tree, "ShaderNodeMixShader"), add_node(tree, "ShaderNodeAddShader")
    mix.inputs[0].default_value = 0.25
    tree.links.new(add_node(tree, "ShaderNodeBsdfDiffuse", Color=RED).outputs[0], mix.inputs[1])
    tree.links.new(add_node(tree, "ShaderNodeBsdfGlass", Color=GREEN).outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], add.inputs[0])
    tree.links.new(add_node(tree, "ShaderNodeEmission", Strength=3).outputs[0], add.inputs[1])
    tree.links.new(add.outputs[0], surface)
    got, notes = export_material(material)
    assert notes == []
    red, green = np.array(RED[:3]), np.array(GREEN[:3])
    assert weights(got) == {K.DIFFUSE: 0.75 * red, K.GLASS: 0.25 * green, K.EMISSION: np.full(3, 3.0)}
    assert {c.kind: c.color for c in got.closures}[K.GLASS] == pytest.approx(green)
    mix.inputs[0].default_value = 7
    assert weights(export_material(material)[0]) == {K.GLASS: green, K.EMISSION: np.full(3, 3.0)}


def test_principled_layers_share_the_light():
    material, notes = of_one(
        "ShaderNodeBsdfPrincipled",
        Base_Color=RED,
        Metallic=0.5,
        Roughness=0.25,
        IOR=1.75,
        Alpha=0.75,
        Transmission_Weight=0.25,
        Emission_Color=GREEN,
        Emission_Strength=2,
    )
    assert notes == []
    red, green = np.array(RED[:3]), np.array(GREEN[:3])
    plastic = 0.75 * 0.5 * 0.75
    assert weights(material) == {
        K.TRANSPARENT: np.full(3, 0.25),
        K.EMISSION: 0.75 * 2 * green,
        K.METAL: 0.75 * 0.5 * red,
        K.GLASS: np.full(3, 0.75 * 0.5 * 0.25),
        K.DIELECTRIC: np.full(3, plastic),
        K.LAYERED_DIFFUSE: plastic * red,
    }
    by_kind = {closure.kind: closure for closure in material.closures}
    for kind in (K.METAL, K.GLASS, K.DIELECTRIC, K.LAYERED_DIFFUSE):
        assert by_kind[kind].roughness == 0.25
    for kind in (K.GLASS, K.DIELECTRIC, K.LAYERED_DIFFUSE):
        assert by_kind[kind].ior == 1.75
    assert by_kind[K.METAL].edge == (1, 1, 1)
    assert by_kind[K.METAL].weight == (0.375,) * 3
    assert by_kind[K.GLASS].refraction == pytest.approx(np.sqrt(red))


def test_principled_kinds_do_not_depend_on_values():
    kinds = of_one("ShaderNodeBsdfPrincipled")[0].kinds
    assert kinds == of_one("ShaderNodeBsdfPrincipled", Metallic=1, Alpha=0.5, Emission_Strength=1)[0].kinds
    assert set(kinds) >= {K.METAL, K.GLASS, K.EMISSION, K.TRANSPARENT, K.DIELECTRIC, K.LAYERED_DIFFUSE}


def test_principled_values_are_clamped_as_blender_does():
    material, _ = of_one("ShaderNodeBsdfPrincipled", Base_Color=(-1, 0.5, 3, 1), Metallic=1.5, Roughness=-2)
    assert weights(material) == {K.METAL: np.array([0, 0.5, 1])}
    assert material.closures[0].roughness == 0


def test_specular_level_scales_the_reflectance_of_the_coat():
    def reflectance(level):
        material, _ = of_one("ShaderNodeBsdfPrincipled", IOR=1.5, Specular_IOR_Level=level)
        coat = [closure for closure in material.closures if closure.kind == K.DIELECTRIC]
        return ((coat[0].ior - 1) / (coat[0].ior + 1)) ** 2 if coat else 0

    assert reflectance(0.5) == pytest.approx(0.04)
    assert reflectance(0.25) == pytest.approx(0.02)
    assert reflectance(1) == pytest.approx(0.08)
    assert reflectance(0) == 0


def test_layers_that_depend_on_the_view_make_a_program():
    material, notes = of_one("ShaderNodeBsdfPrincipled", Coat_Weight=0.5, Sheen_Weight=0.5)
    assert notes == [] and material.closures == () and K.SHEEN in material.kinds
    assert {"layer_coat", "layer_sheen", "dielectric", "sheen", "layered_diffuse"} <= set(material.program.ops)
    plain = of_one("ShaderNodeBsdfPrincipled")[0]
    assert plain.program is None and K.SHEEN not in plain.kinds


def test_what_is_approximated_is_named():
    material, tree, surface = new_material()
    node = add_node(tree, "ShaderNodeSubsurfaceScattering")
    node.inputs["Color"].default_value = RED
    tree.links.new(node.outputs[0], surface)
    offered = {item.identifier for item in node.bl_rna.properties["falloff"].enum_items}
    for method, approximated in (
        ("RANDOM_WALK", False),
        ("RANDOM_WALK_SKIN", False),
        ("RANDOM_WALK_LEGACY", False),
        ("BURLEY", True),
    ):
        if method not in offered:
            continue
        node.falloff = method
        made, notes = export_material(material)
        assert weights(made) == {K.SUBSURFACE: np.array(RED[:3])} and K.DIFFUSE in made.kinds
        assert len(notes) == approximated
    assert "random walk" in notes[0] and "Subsurface Scattering" in notes[0]


@pytest.mark.parametrize("sampling, said", [("FRONT", 1), ("BACK", 1), ("FRONT_BACK", 0), ("AUTO", 0), ("NONE", 0)])
def test_sampling_of_one_side_of_what_emits_is_named(sampling, said):
    material, tree, surface = new_material()
    material.cycles.emission_sampling = sampling
    diffuse, emission = add_node(tree, "ShaderNodeBsdfDiffuse"), add_node(tree, "ShaderNodeEmission")
    tree.links.new(diffuse.outputs[0], surface)
    assert export_material(material)[1] == []
    tree.links.new(emission.outputs[0], surface)
    notes = export_material(material)[1]
    assert len(notes) == said and all(each.weight == Weight.SETTING and each.remedy for each in notes)


def test_subsurface_takes_its_share_of_the_base():
    material, notes = of_one("ShaderNodeBsdfPrincipled", Subsurface_Weight=0.5)
    assert notes == [] and {K.SUBSURFACE, K.DIFFUSE} <= set(material.kinds)
    assert "subsurface" in material.program.ops
    plain = of_one("ShaderNodeBsdfPrincipled")[0]
    assert K.SUBSURFACE not in plain.kinds


@pytest.mark.parametrize(
    "node, inputs", [("ShaderNodeEmission", {"Strength": -2}), ("ShaderNodeBsdfPrincipled", {"Emission_Strength": -2})]
)
def test_negative_emission_is_taken_as_none_and_named(node, inputs):
    """Blender allows negative emission, and subtracts light."""
    material, notes = of_one(node, **inputs)
    assert K.EMISSION in material.kinds and K.EMISSION not in {closure.kind for closure in material.closures}
    (note,) = notes
    assert "negative" in note and "Strength" in note


def test_value_and_color_nodes_reroutes_and_muted_nodes_are_seen_through():
    material, tree, surface = new_material()
    mix, diffuse = add_node(tree, "ShaderNodeMixShader"), add_node(tree, "ShaderNodeBsdfDiffuse")
    color, value, reroute = (
        tree.nodes.new("ShaderNodeRGB"),
        tree.nodes.new("ShaderNodeValue"),
        tree.nodes.new("NodeReroute"),
    )
    color.outputs[0].default_value, value.outputs[0].default_value = RED, 0.25
    tree.links.new(color.outputs[0], diffuse.inputs["Color"])
    tree.links.new(value.outputs[0], reroute.inputs[0])
    tree.links.new(reroute.outputs[0], mix.inputs[0])
    tree.links.new(diffuse.outputs[0], mix.inputs[1])
    tree.links.new(mix.outputs[0], surface)
    assert weights(export_material(material)[0]) == {K.DIFFUSE: 0.75 * np.array(RED[:3])}
    mix.mute = True
    assert weights(export_material(material)[0]) == {K.DIFFUSE: np.array(RED[:3])}


def test_a_color_as_number_is_its_luminance_and_a_number_as_color_is_grey():
    material, tree, surface = new_material()
    emission = add_node(tree, "ShaderNodeEmission", Color=(1, 1, 1, 1))
    color, value = tree.nodes.new("ShaderNodeRGB"), tree.nodes.new("ShaderNodeValue")
    color.outputs[0].default_value, value.outputs[0].default_value = (0, 1, 0, 1), 0.5
    tree.links.new(color.outputs[0], emission.inputs["Strength"])
    tree.links.new(value.outputs[0], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], surface)
    assert weights(export_material(material)[0]) == {K.EMISSION: np.full(3, 0.5 * 0.71516868)}


def test_node_groups_within_node_groups_pass_values_in_and_shaders_out():
    def group(name, fill):
        tree = bpy.data.node_groups.new(name, "ShaderNodeTree")
        tree.interface.new_socket("Tint", in_out="INPUT", socket_type="NodeSocketColor")
        tree.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
        fill(tree, tree.nodes.new("NodeGroupInput").outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0])
        return tree

    def fill_inner(tree, tint, end):
        diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
        tree.links.new(tint, diffuse.inputs["Color"])
        tree.links.new(diffuse.outputs[0], end)

    inner = group("Inner", fill_inner)

    def fill_outer(tree, tint, end):
        node = tree.nodes.new("ShaderNodeGroup")
        node.node_tree = inner
        tree.links.new(tint, node.inputs[0])
        tree.links.new(node.outputs[0], end)

    material, tree, surface = new_material()
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group("Outer", fill_outer)
    node.inputs[0].default_value = RED
    tree.links.new(node.outputs[0], surface)
    assert weights(export_material(material)[0]) == {K.DIFFUSE: np.array(RED[:3])}
    color = tree.nodes.new("ShaderNodeRGB")
    color.outputs[0].default_value = GREEN
    tree.links.new(color.outputs[0], node.inputs[0])
    assert weights(export_material(material)[0]) == {K.DIFFUSE: np.array(GREEN[:3])}


@pytest.mark.parametrize("what", ["texture", "shader", "mix by texture"])
def test_what_is_not_supported_is_replaced_and_named_with_node_and_objects(what):
    obj = add_triangle("Thing")
    add_object("Other", obj.data)
    material = material_of(obj, "Odd")
    tree, surface = node_tree(material)
    unknown = tree.nodes.new("ShaderNodeUVAlongStroke")
    if what == "texture":
        shader = add_node(tree, "ShaderNodeBsdfDiffuse")
        tree.links.new(unknown.outputs[0], shader.inputs["Color"])
    elif what == "shader":
        shader = tree.nodes.new("ShaderNodeEeveeSpecular")
    else:
        shader = tree.nodes.new("ShaderNodeMixShader")
        tree.links.new(unknown.outputs[0], shader.inputs[0])
        tree.links.new(add_node(tree, "ShaderNodeBsdfDiffuse", Color=RED).outputs[0], shader.inputs[1])
    tree.links.new(shader.outputs[0], surface)
    material.diffuse_color = (0.5, 0.25, 0.125, 1)
    scene = exported()
    (got,) = scene.materials
    expected = {
        "texture": {},
        "shader": {K.DIFFUSE: np.array([0.5, 0.25, 0.125])},
        "mix by texture": {K.DIFFUSE: np.array(RED[:3])},
    }[what]
    assert weights(got) == expected
    (warning,) = scene.warnings
    for name in (
        "“Odd”",
        "Specular BSDF" if what == "shader" else "UV Along Stroke",
        "“Thing”",
        "“Other”",
        "viewport colour" if what == "shader" else "it gives 0",
    ):
        assert name in warning


def test_a_handler_that_fails_costs_its_own_node_alone(monkeypatch):
    def fail(node, weight):
        node.closure("emission", weight)
        raise KeyError("no such socket")

    monkeypatch.setitem(shader_nodes, "ShaderNodeEmission", Handled("ShaderNodeEmission", "Shaders", fail))
    material, tree, surface = new_material()
    add = add_node(tree, "ShaderNodeAddShader")
    tree.links.new(add_node(tree, "ShaderNodeEmission").outputs[0], add.inputs[0])
    tree.links.new(add_node(tree, "ShaderNodeBsdfGlass").outputs[0], add.inputs[1])
    tree.links.new(add.outputs[0], surface)
    got, notes = export_material(material)
    assert set(weights(got)) == {K.DIFFUSE, K.GLASS}
    (note,) = notes
    assert "Emission" in note and "no such socket" in note and "viewport colour" in note


def test_a_color_in_place_of_a_shader_shines():
    material, tree, surface = new_material()
    color = tree.nodes.new("ShaderNodeRGB")
    color.outputs[0].default_value = RED
    tree.links.new(color.outputs[0], surface)
    got, notes = export_material(material)
    assert notes == [] and weights(got) == {K.EMISSION: np.array(RED[:3])}


def test_normals_of_closures_count_where_something_is_linked_to_them():
    for linked in (False, True):
        material, tree, surface = new_material()
        diffuse = add_node(tree, "ShaderNodeBsdfDiffuse")
        coordinates = tree.nodes.new("ShaderNodeTexCoord")
        tree.links.new(coordinates.outputs["Object"], diffuse.inputs["Color"])
        if linked:
            tree.links.new(coordinates.outputs["Normal"], diffuse.inputs["Normal"])
        tree.links.new(diffuse.outputs[0], surface)
        got, _ = export_material(material)
        assert got.program is not None and (K.OWN_NORMAL in got.kinds) == linked


def test_values_that_are_not_finite_fall_back():
    material, _ = of_one("ShaderNodeEmission", Strength=math.inf)
    assert all(np.isfinite(closure.weight).all() for closure in material.closures)


def test_nothing_linked_is_black_and_a_volume_alone_has_no_surface():
    material, tree, _ = new_material()
    assert export_material(material)[0].closures == ()
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], output.inputs["Volume"])
    got, notes = export_material(material)
    assert weights(got) == {K.TRANSPARENT: np.ones(3)} and not notes
    (closure,) = got.volume.closures
    assert closure.kind == K.HENYEY_GREENSTEIN and np.allclose(closure.weight, 0.8)


@pytest.mark.parametrize(("filled", "opaque"), [(False, True), (True, False)])
def test_shadow_rays_look_at_what_has_a_volume_whatever_it_says(filled, opaque):
    material, tree, surface = new_material()
    tree.links.new(tree.nodes.new("ShaderNodeBsdfTransparent").outputs[0], surface)
    if filled:
        tree.links.new(tree.nodes.new("ShaderNodeVolumeAbsorption").outputs[0], surface.node.inputs["Volume"])
    material.use_transparent_shadow = False
    assert export_material(material)[0].shadow_opaque == opaque


def test_the_output_for_cycles_counts_before_others():
    material, tree, surface = new_material()
    tree.links.new(add_node(tree, "ShaderNodeBsdfDiffuse", Color=RED).outputs[0], surface)
    other = tree.nodes.new("ShaderNodeOutputMaterial")
    other.target = "EEVEE"
    tree.links.new(add_node(tree, "ShaderNodeEmission").outputs[0], other.inputs["Surface"])
    assert export_material(material)[0].kinds == (K.DIFFUSE,)
    other.target = "CYCLES"
    assert export_material(material)[0].kinds == (K.EMISSION,)
