"""Groups, zones, muted nodes and links to nothing.

From 5.0 on Blender's own simplification resolves them, before that the export.
"""

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.export.materials import export_material
from raybatch_addon.export.nodes.compile import CLOSURES_MOST
from tests.support.blender_builders import add_triangle, exported, material_of, node_tree

pytestmark = pytest.mark.usefixtures("scene")
SIMPLIFIES = bpy.app.version >= (5, 0)
ZONES = pytest.mark.skipif(not SIMPLIFIES, reason="shader graphs have zones from Blender 5.0 on")


@pytest.fixture(params=["for all engines", "for Cycles"])
def shine(request):
    """A material's tree and its white emission of strength 0.5.

    Blender does not simplify a graph whose output is for Cycles alone.
    """
    material = bpy.data.materials.new("Odd")
    tree, surface = node_tree(material)
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value, emission.inputs["Strength"].default_value = (1, 1, 1, 1), 0.5
    tree.links.new(emission.outputs[0], surface)
    if request.param == "for Cycles":
        surface.node.target = "CYCLES"
    return material, tree, emission


def shown(material):
    """Red of the emission of a material without program, of which nothing was left out."""
    made, notes = export_material(material)
    assert notes == [] and made.program is None
    return sum(closure.weight[0] for closure in made.closures)


def add_group(tree, fill, kinds=("Vector", "Float"), given=None):
    """A node of a new group; `fill` is called with its tree, its input node and the input of its output node."""
    group = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
    group.interface.new_socket("In", in_out="INPUT", socket_type=f"NodeSocket{kinds[0]}")
    group.interface.new_socket("Out", in_out="OUTPUT", socket_type=f"NodeSocket{kinds[1]}")
    fill(group, group.nodes.new("NodeGroupInput").outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    if given is not None:
        node.inputs[0].default_value = given
    return node


@pytest.mark.parametrize("kind", ["ShaderNodeTexNoise", "ShaderNodeValue", "ShaderNodeTexImage"])
def test_a_muted_node_that_passes_nothing_leaves_the_inputs_own_value(shine, kind):
    material, tree, emission = shine
    node = tree.nodes.new(kind)
    node.mute = True
    tree.links.new(node.outputs[0], emission.inputs["Strength"])
    assert shown(material) == 0.5


def test_a_muted_node_passes_its_links_but_not_its_own_values(shine):
    material, tree, emission = shine
    node = tree.nodes.new("ShaderNodeMath")
    node.mute = True
    node.inputs[0].default_value = 0.75
    tree.links.new(node.outputs[0], emission.inputs["Strength"])
    assert shown(material) == (0.5 if SIMPLIFIES else 0)
    value = tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = 0.25
    tree.links.new(value.outputs[0], node.inputs[0])
    assert shown(material) == 0.25


def test_a_muted_group_passes_its_links_but_not_its_own_values(shine):
    material, tree, emission = shine
    node = add_group(tree, lambda group, start, end: group.links.new(start, end), ("Float", "Float"), 0.25)
    node.mute = True
    tree.links.new(node.outputs[0], emission.inputs["Strength"])
    assert shown(material) == (0.5 if SIMPLIFIES else 0)


@pytest.mark.parametrize("muted", [False, True])
def test_a_reroute_that_leads_to_nothing(shine, muted):
    material, tree, emission = shine
    reroute = tree.nodes.new("NodeReroute")
    tree.links.new(reroute.outputs[0], emission.inputs["Strength"])
    if muted:
        node = tree.nodes.new("ShaderNodeTexNoise")
        node.mute = True
        tree.links.new(node.outputs[0], reroute.inputs[0])
    assert shown(material) == (0.5 if SIMPLIFIES else 0)


def gradient_of_a_group(tree, hidden=False):
    """A group whose output is a gradient along x at its input, which has no link."""

    def fill(group, start, end):
        texture = group.nodes.new("ShaderNodeTexGradient")
        group.links.new(start, texture.inputs[0])
        group.links.new(texture.outputs[1], end)
        group.interface.items_tree["In"].hide_value = hidden

    return add_group(tree, fill, given=(0.625, 0, 0))


def test_an_unlinked_input_of_a_group_is_a_constant_from_blender_5_on(shine):
    material, tree, emission = shine
    tree.links.new(gradient_of_a_group(tree).outputs[0], emission.inputs["Strength"])
    if SIMPLIFIES:
        assert shown(material) == 0.625
    else:  # coordinates without link are generated ones
        assert "generated" in export_material(material)[0].program.ops


@pytest.mark.parametrize("hidden", [False, True])
def test_normals_of_groups_are_constants_unless_their_values_are_hidden(shine, hidden):
    material, tree, emission = shine

    def fill(group, start, end):
        fresnel = group.nodes.new("ShaderNodeFresnel")
        group.links.new(start, fresnel.inputs["Normal"])
        group.links.new(fresnel.outputs[0], end)
        group.interface.items_tree["In"].hide_value = hidden

    tree.links.new(add_group(tree, fill, given=(1, 0, 0)).outputs[0], emission.inputs["Strength"])
    made, notes = export_material(material)
    assert notes == []
    assert ("normals" in made.program.ops) == (hidden or not SIMPLIFIES)


def test_groups_of_add_ons_are_followed(shine):
    material, tree, emission = shine

    class Own(bpy.types.ShaderNodeCustomGroup):
        bl_idname = "OwnGroupOfATest"
        bl_label = "Own"

    bpy.utils.register_class(Own)
    try:
        made = add_group(tree, lambda group, start, end: group.links.new(start, end), ("Float", "Float"))
        node = tree.nodes.new("OwnGroupOfATest")
        node.node_tree = made.node_tree
        node.inputs[0].default_value = 0.25
        tree.links.new(node.outputs[0], emission.inputs["Strength"])
        assert shown(material) == 0.25
        tree.nodes.remove(node)
    finally:
        bpy.utils.unregister_class(Own)


@pytest.mark.parametrize("given, truth", [(0.3125, 1), (2.5, 1), (-0.5, 0)])
def test_numbers_as_booleans(shine, given, truth):
    """Up to 4.5 Cycles treats booleans as whole numbers."""
    material, tree, emission = shine
    value = tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = given
    node = add_group(tree, lambda group, start, end: group.links.new(start, end), ("Bool", "Float"))
    tree.links.new(value.outputs[0], node.inputs[0])
    tree.links.new(node.outputs[0], emission.inputs["Strength"])
    assert shown(material) == (truth if SIMPLIFIES else int(given))


@pytest.fixture
def plain():
    """A material, its tree and emission, which Blender simplifies."""
    material = material_of(add_triangle("Thing"), "Odd")
    tree, surface = node_tree(material)
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(emission.outputs[0], surface)
    return material, tree, emission


@ZONES
def test_repeat_zones(plain):
    material, tree, emission = plain
    start, end = tree.nodes.new("GeometryNodeRepeatInput"), tree.nodes.new("GeometryNodeRepeatOutput")
    start.pair_with_output(end)
    end.repeat_items.clear()
    end.repeat_items.new("FLOAT", "Sum")
    start.inputs["Iterations"].default_value = 3
    add = tree.nodes.new("ShaderNodeMath")
    add.inputs[1].default_value = 0.25
    tree.links.new(start.outputs["Sum"], add.inputs[0])
    tree.links.new(add.outputs[0], end.inputs["Sum"])
    tree.links.new(end.outputs["Sum"], emission.inputs["Strength"])
    assert shown(material) == 0.75


@ZONES
def test_closures_bundles_and_menus(plain):
    material, tree, emission = plain
    start, end, call = (
        tree.nodes.new(kind) for kind in ("NodeClosureInput", "NodeClosureOutput", "NodeEvaluateClosure")
    )
    start.pair_with_output(end)
    for node in (end, call):
        node.input_items.new("FLOAT", "Given")
        node.output_items.new("FLOAT", "Made")
    double = tree.nodes.new("ShaderNodeMath")
    double.operation, double.inputs[1].default_value = "MULTIPLY", 2
    tree.links.new(start.outputs["Given"], double.inputs[0])
    tree.links.new(double.outputs[0], end.inputs["Made"])
    tree.links.new(end.outputs[0], call.inputs[0])
    menu = tree.nodes.new("GeometryNodeMenuSwitch")
    menu.data_type = "FLOAT"
    menu.inputs["A"].default_value, menu.inputs["B"].default_value = 0.375, 7
    tree.links.new(menu.outputs[0], call.inputs["Given"])
    bundle, parts = tree.nodes.new("NodeCombineBundle"), tree.nodes.new("NodeSeparateBundle")
    for node in (bundle, parts):
        node.bundle_items.new("FLOAT", "Kept")
    tree.links.new(call.outputs["Made"], bundle.inputs["Kept"])
    tree.links.new(bundle.outputs[0], parts.inputs[0])
    tree.links.new(parts.outputs["Kept"], emission.inputs["Strength"])
    assert shown(material) == 0.75


@ZONES
@pytest.mark.parametrize(
    "kind, name, value, light",
    [("Int", "integer", 2, 2), ("Bool", "boolean", True, 1), ("Vector", "vector", (0.75,) * 3, 0.75)],
)
def test_inputs_of_all_kinds_of_trees(shine, kind, name, value, light):
    material, tree, emission = shine
    node = tree.nodes.new(f"FunctionNodeInput{kind}")
    setattr(node, name, value)
    tree.links.new(node.outputs[0], emission.inputs["Strength"])
    assert shown(material) == light


def test_messages_name_nodes_as_the_user_does(plain):
    _, tree, emission = plain

    def fill(group, start, end):
        group.nodes.new("ShaderNodeUVAlongStroke").name = "12_Stroke"
        group.links.new(group.nodes[-1].outputs[0], end)

    for _ in range(2):
        node = add_group(tree, fill, ("Vector", "Color"))
    tree.links.new(node.outputs[0], emission.inputs["Color"])
    (warning,) = exported().warnings
    assert "material “Odd” of “Thing”" in warning and "node “12_Stroke” (UV Along Stroke)" in warning


def test_links_that_settings_hide_are_no_mistakes(plain):
    material, tree, emission = plain
    emission.inputs["Strength"].default_value = 0.5
    node = tree.nodes.new("ShaderNodeVectorMath")
    node.operation = "LENGTH"
    tree.links.new(node.outputs["Value"], emission.inputs["Strength"])
    node.operation = "ADD"
    assert shown(material) == 0.5


def mixed(tree, shader, count):
    """`shader` mixed with itself `count` times."""
    for _ in range(count):
        mix = tree.nodes.new("ShaderNodeMixShader")
        mix.inputs[0].default_value = 0.25
        tree.links.new(shader, mix.inputs[1])
        tree.links.new(shader, mix.inputs[2])
        shader = mix.outputs[0]
    return shader


def test_a_shader_that_is_used_often_adds_its_closures_once(plain):
    material, tree, emission = plain
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    tree.links.new(mixed(tree, emission.outputs[0], 12), output.inputs["Surface"])
    assert shown(material) == pytest.approx(1, abs=1e-6)
    assert len(export_material(material)[0].closures) == 1


def test_weights_of_a_shared_shader_are_added_where_they_vary(plain):
    material, tree, emission = plain
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    mix, add = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeAddShader")
    tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs[0], mix.inputs[0])
    tree.links.new(emission.outputs[0], mix.inputs[1])
    tree.links.new(tree.nodes.new("ShaderNodeBsdfDiffuse").outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], add.inputs[0])
    tree.links.new(emission.outputs[0], add.inputs[1])
    tree.links.new(add.outputs[0], output.inputs["Surface"])
    program = export_material(material)[0].program
    closures = [step.op for step in program.instructions if step.op in ("emission", "diffuse")]
    assert closures == ["diffuse", "emission"]  # the shared one comes last, with the sum of both weights
    assert "vector_math" in program.ops and program.closure_count == 2


@pytest.mark.parametrize("varying", [False, True])
def test_a_point_has_no_more_closures_than_in_cycles(plain, varying):
    _material, tree, emission = plain
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    shader = emission.outputs[0]
    for _ in range(CLOSURES_MOST + 6):
        add, diffuse = tree.nodes.new("ShaderNodeAddShader"), tree.nodes.new("ShaderNodeBsdfDiffuse")
        diffuse.inputs["Color"].default_value = (0.01, 0.01, 0.01, 1)
        if varying:
            tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs[0], diffuse.inputs["Color"])
        tree.links.new(shader, add.inputs[0])
        tree.links.new(diffuse.outputs[0], add.inputs[1])
        shader = add.outputs[0]
    tree.links.new(shader, output.inputs["Surface"])
    scene = exported()
    (made,) = scene.materials
    assert (made.program.closure_count if varying else len(made.closures)) == CLOSURES_MOST
    (warning,) = scene.warnings
    assert (
        "material “Odd” of “Thing”" in warning
        and f"{CLOSURES_MOST + 7} closures" in warning
        and K.EMISSION in made.kinds
    )


@pytest.mark.parametrize("how", ["key", "driver", "key of the group's input", "nothing"])
def test_what_is_animated_has_its_kind_at_every_value(plain, how):
    """Otherwise the frames of one animation would be compiled one by one."""
    material, tree, _emission = plain
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    inner = []

    def fill(group, start, end):
        inner.append(group.nodes.new("ShaderNodeBsdfDiffuse").inputs["Roughness"])
        if "input" in how:
            group.links.new(start, inner[0])
        group.links.new(inner[0].node.outputs[0], end)

    node = add_group(tree, fill, ("Float", "Shader"), 0.0)
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    animated = node.inputs[0] if "input" in how else inner[0]
    if "key" in how:
        animated.keyframe_insert("default_value", frame=1)
    elif how == "driver":
        animated.driver_add("default_value").driver.expression = "0.0"
    assert (K.ROUGH_DIFFUSE in export_material(material)[0].kinds) == (how != "nothing")


def test_a_value_that_is_linked_has_its_kind_though_it_is_0(plain):
    material, tree, _ = plain
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    diffuse, value = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = 0
    tree.links.new(value.outputs[0], diffuse.inputs["Roughness"])
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    assert K.ROUGH_DIFFUSE in export_material(material)[0].kinds


def test_the_normal_that_displacement_bends_is_the_surfaces_alone(plain):
    material, tree, emission = plain
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    geometry, displacement, add = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("NewGeometry", "Displacement", "VectorMath")
    )
    noise, height = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeVectorMath")
    height.operation = "DOT_PRODUCT"
    tree.links.new(geometry.outputs["Normal"], height.inputs[0])
    tree.links.new(noise.outputs["Color"], height.inputs[1])
    tree.links.new(height.outputs["Value"], displacement.inputs["Height"])
    tree.links.new(displacement.outputs[0], output.inputs["Displacement"])
    tree.links.new(geometry.outputs["Normal"], add.inputs[0])
    tree.links.new(add.outputs[0], emission.inputs["Color"])
    program = export_material(material)[0].program
    step_of = {step.op: i for i, step in enumerate(program.instructions)}
    bent = program.instructions[step_of["bump"]].words[-1]
    shown_normal = [step for step in program.instructions[step_of["bump"] :] if step.op == "vector_math"]
    assert [step.words[1] for step in shown_normal] == [bent]


@pytest.mark.parametrize("grouped", [False, True])
def test_paths_in_linked_materials_start_at_their_own_file(plain, tmp_path, grouped):
    material, tree, emission = plain

    def fill(tree, end):
        node = tree.nodes.new("ShaderNodeTexIES")
        node.mode, node.filepath = "EXTERNAL", "//lamp.ies"
        tree.links.new(node.outputs[0], end)

    if grouped:
        node = add_group(tree, lambda group, start, end: fill(group, end), ("Float", "Float"))
        tree.links.new(node.outputs[0], emission.inputs["Strength"])
    else:
        fill(tree, emission.inputs["Strength"])
    library = tmp_path / "library.blend"
    (tmp_path / "lamp.ies").write_text(
        "IESNA:LM-63-1995\nTILT=NONE\n1 1000 1 3 1 1 2 0 0 0\n1 1 1\n0 45 90\n0\n10 20 30\n"
    )
    bpy.data.libraries.write(str(library), {material})
    with bpy.data.libraries.load(str(library), link=True) as (_, to):
        to.materials = [material.name]
    bpy.data.objects["Thing"].data.materials[0] = to.materials[0]
    scene = exported()
    assert scene.warnings == () and "ies" in scene.materials[0].program.ops
