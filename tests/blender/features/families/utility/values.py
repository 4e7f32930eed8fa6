"""Nodes of mathematics, conversion and operations on vectors and colours, alone."""

from math import pi as PI

import bpy

from tests.blender.features.graph import Graph
from tests.blender.features.registry import feature


def operations(kind: str, name: str = "operation") -> tuple[str, ...]:
    """Choices in a node's menu."""
    return tuple(item.identifier for item in getattr(bpy.types, kind).bl_rna.properties[name].enum_items)


@feature("Math", "Utility", "node", variants=operations("ShaderNodeMath"), quick=True, offset=128.0)
def math(graph: Graph, operation: str):
    third = 0.5 if operation in ("SMOOTH_MIN", "SMOOTH_MAX", "COMPARE") else graph.z
    return graph.math(operation, graph.x, graph.y, third)


@feature("Math: clamped", "Utility", "node", variants=("ADD", "DIVIDE", "TANGENT"))
def math_clamped(graph: Graph, operation: str):
    return graph.math(operation, graph.x, graph.y, clamp=True)


@feature("Vector Math", "Utility", "node", variants=operations("ShaderNodeVectorMath"), quick=True, offset=128.0)
def vector_math(graph: Graph, operation: str):
    second = graph.vector_math("MULTIPLY_ADD", graph.point, (-0.5, 0.75, 1.25), (0.25, -0.5, 0.125))
    node = graph.node("ShaderNodeVectorMath", {0: graph.point, 1: second}, operation=operation)
    if operation == "SCALE":
        graph.set(node.inputs["Scale"], graph.y)
    elif operation == "REFRACT":
        graph.set(node.inputs["Scale"], 0.7)
    elif operation in ("MULTIPLY_ADD", "WRAP", "FACEFORWARD"):
        graph.set(node.inputs[2], (0.3, -0.6, 0.4))
    return graph.outputs(node)


RANGES = tuple(
    (kind, interpolation, clamp)
    for kind in ("FLOAT", "FLOAT_VECTOR")
    for interpolation in operations("ShaderNodeMapRange", "interpolation_type")
    for clamp in (True, False)
)


@feature("Map Range", "Utility", "node", quick=True, variants=RANGES)
def map_range(graph: Graph, variant: tuple):
    kind, interpolation, clamp = variant
    node = graph.node("ShaderNodeMapRange", data_type=kind, interpolation_type=interpolation, clamp=clamp)
    if kind == "FLOAT":
        values = {"Value": graph.x, "From Min": -1.0, "From Max": 1.25, "To Min": 2.0, "To Max": graph.y, "Steps": 5.0}
    else:
        values = {
            "Vector": graph.point,
            "From_Min_FLOAT3": (-1.0, -0.5, 1.0),
            "From_Max_FLOAT3": (1.0, 1.5, -0.7),
            "To_Min_FLOAT3": (2.0, 0.0, 0.0),
            "To_Max_FLOAT3": (0.0, 1.0, 3.0),
            "Steps_FLOAT3": (5.0, 4.0, 3.0),
        }
    graph.fill(node, values)
    return graph.outputs(node)


@feature("Clamp", "Utility", "node", variants=("MINMAX", "RANGE"), quick=True)
def clamp(graph: Graph, kind: str):
    return graph.value("ShaderNodeClamp", {"Value": graph.x, "Min": 0.75, "Max": graph.y}, clamp_type=kind)


@feature("Combine and Separate XYZ", "Utility", "node", quick=True)
def combine_xyz(graph: Graph):
    parts = graph.node("ShaderNodeSeparateXYZ", {0: graph.point}).outputs
    return graph.value("ShaderNodeCombineXYZ", {0: parts[2], 1: parts[0], 2: parts[1]})


@feature("Combine Color", "Utility", "node", variants=("RGB", "HSV", "HSL"), quick=True)
def combine_color(graph: Graph, mode: str):
    parts = graph.node("ShaderNodeSeparateXYZ", {0: graph.unit}).outputs
    return graph.value("ShaderNodeCombineColor", {0: parts[0], 1: parts[1], 2: parts[2]}, mode=mode)


@feature("Separate Color", "Utility", "node", variants=("RGB", "HSV", "HSL"), quick=True)
def separate_color(graph: Graph, mode: str):
    return graph.outputs(graph.node("ShaderNodeSeparateColor", {0: graph.unit}, mode=mode))


@feature("Mapping", "Utility", "node", variants=operations("ShaderNodeMapping", "vector_type"), quick=True)
def mapping(graph: Graph, kind: str):
    values = {
        "Vector": graph.point,
        "Location": (0.2, -1.0, 0.6),
        "Rotation": (0.3, -0.7, 1.9),
        "Scale": (1.5, 0.4, -2.0),
    }
    return graph.fill(graph.node("ShaderNodeMapping", vector_type=kind), values).outputs[0]


@feature("Mapping: linked", "Utility", "node", variants=operations("ShaderNodeMapping", "vector_type"))
def mapping_linked(graph: Graph, kind: str):
    scale = graph.vector_math("ADD", graph.unit, (0.5, 0.5, 0.5))
    return graph.value(
        "ShaderNodeMapping", {"Vector": graph.point, "Rotation": graph.point, "Scale": scale}, vector_type=kind
    )


ROTATIONS = operations("ShaderNodeVectorRotate", "rotation_type")


@feature(
    "Vector Rotate", "Utility", "node", variants=tuple((kind, invert) for kind in ROTATIONS for invert in (False, True))
)
def vector_rotate(graph: Graph, variant: tuple):
    kind, invert = variant
    values = {
        "Vector": graph.point,
        "Center": (0.2, -0.1, 0.4),
        "Axis": (0.3, -1.0, 0.5),
        "Angle": graph.y,
        "Rotation": (0.3, 1.2, -0.8),
    }
    return graph.fill(graph.node("ShaderNodeVectorRotate", rotation_type=kind, invert=invert), values).outputs[0]


SPACES = ("WORLD", "OBJECT", "CAMERA")


TRANSFORMS = tuple((kind, a, b) for kind in ("POINT", "VECTOR", "NORMAL") for a in SPACES for b in SPACES if a != b)


@feature("Vector Transform", "Utility", "node", variants=TRANSFORMS, offset=128.0)
def vector_transform(graph: Graph, variant: tuple):
    kind, source, target = variant
    # a quarter of a turn: pixels' middles stay in the middle of the cells of `point`
    graph.obj.rotation_euler, graph.obj.scale = (0.0, 0.0, PI / 2), (0.5, 0.5, 0.8)
    return graph.value(
        "ShaderNodeVectorTransform", {0: graph.unit}, vector_type=kind, convert_from=source, convert_to=target
    )


@feature("Normal", "Utility", "node")
def normal(graph: Graph):
    node = graph.node("ShaderNodeNormal", {0: graph.point})
    node.outputs[0].default_value = (0.6, 0.0, 0.8)
    return {"Dot": node.outputs["Dot"]}


@feature("Blackbody", "Utility", "node", quick=True, offset=0.0)
def blackbody(graph: Graph):
    place = graph.math("ADD", graph.x, graph.math("MULTIPLY", graph.y, 0.1))
    return graph.value("ShaderNodeBlackbody", {0: graph.math("MULTIPLY_ADD", place, 3500.0, 6600.0)})


@feature("Wavelength", "Utility", "node", quick=True)
def wavelength(graph: Graph):
    place = graph.math("ADD", graph.x, graph.math("MULTIPLY", graph.y, 0.1))
    return graph.value("ShaderNodeWavelength", {0: graph.math("MULTIPLY_ADD", place, 120.0, 560.0)})


@feature("RGB to BW", "Utility", "node", quick=True)
def rgb_to_bw(graph: Graph):
    return graph.value("ShaderNodeRGBToBW", {0: graph.point})


@feature("Links between unlike sockets", "Utility", "node", quick=True)
def conversions(graph: Graph):
    color = graph.value(
        "ShaderNodeMix", {"A_Color": graph.point, "B_Color": (0.2, 0.6, 0.3), 0: 0.25}, "Result_Color", data_type="RGBA"
    )
    return {
        "color to number": graph.math("ADD", color, 0.0),
        "vector to number": graph.math("ADD", graph.point, 0.0),
        "number to vector": graph.vector_math("MULTIPLY", graph.x, (1.0, 2.0, 3.0)),
        "color to vector": graph.vector_math("MULTIPLY", color, (1.0, 2.0, 3.0)),
        "number to color": graph.value("ShaderNodeGamma", {0: graph.math("ABSOLUTE", graph.x), 1: 2.0}),
    }


def _own_values(graph: Graph) -> dict[str, bpy.types.NodeSocket]:
    """Inputs whose links lead to nothing, and the values that count instead."""

    def shown(socket) -> bpy.types.NodeSocket:
        return graph.math("MULTIPLY_ADD", graph.x, socket, 0.375)

    group = bpy.data.node_groups.new("Of a constant", "ShaderNodeTree")
    group.interface.new_socket("Vector", in_out="INPUT", socket_type="NodeSocketVector").default_value = (
        0.625,
        0.0,
        0.0,
    )
    group.interface.new_socket("Result", in_out="OUTPUT", socket_type="NodeSocketFloat")
    ports, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    group.links.new(Graph(group).value("ShaderNodeTexGradient", {0: ports.outputs[0]}, 1), end.inputs[0])
    given = graph.node("ShaderNodeGroup", node_tree=group)
    scaled = graph.node("ShaderNodeVectorMath", {0: graph.point, 1: (0.125, 0.25, 0.5)}, operation="MULTIPLY")
    graph.set(scaled.inputs[1], graph.value("ShaderNodeBrightContrast", {0: (0.2, 0.4, 0.8), 1: 0.5}, mute=True))
    return {
        "group": shown(given.outputs[0]),
        "muted group": shown(graph.node("ShaderNodeGroup", node_tree=group, mute=True).outputs[0]),
        "reroute": shown(graph.node("NodeReroute").outputs[0]),
        "muted texture": shown(graph.value("ShaderNodeTexNoise", mute=True)),
        "muted value": shown(graph.value("ShaderNodeValue", mute=True)),
        "muted node with a value": shown(graph.value("ShaderNodeMath", {0: 0.75}, mute=True)),
        "muted colour": scaled.outputs[0],
    }


@feature("Node groups, reroutes and muted nodes", "Utility", "node", variants=("linked", "own values"), quick=True)
def groups(graph: Graph, variant: str):
    if variant == "own values":
        return _own_values(graph)
    inner = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
    outer = bpy.data.node_groups.new("Outer", "ShaderNodeTree")
    for tree in (inner, outer):
        tree.interface.new_socket("Value", in_out="INPUT", socket_type="NodeSocketFloat").default_value = 0.7
        tree.interface.new_socket("Other", in_out="INPUT", socket_type="NodeSocketFloat").default_value = 0.3
        tree.interface.new_socket("Result", in_out="OUTPUT", socket_type="NodeSocketFloat")
    inside = Graph(inner)
    ports, end = inner.nodes.new("NodeGroupInput"), inner.nodes.new("NodeGroupOutput")
    inner.links.new(inside.math("MULTIPLY", ports.outputs[0], ports.outputs[1]), end.inputs[0])
    between = Graph(outer)
    ports, end = outer.nodes.new("NodeGroupInput"), outer.nodes.new("NodeGroupOutput")
    nested = outer.nodes.new("ShaderNodeGroup")
    nested.node_tree = inner
    outer.links.new(ports.outputs[0], nested.inputs[0])
    outer.links.new(between.math("ADD", nested.outputs[0], ports.outputs[1]), end.inputs[0])
    node = graph.tree.nodes.new("ShaderNodeGroup")
    node.node_tree = outer
    reroute = graph.tree.nodes.new("NodeReroute")
    graph.set(reroute.inputs[0], graph.x)
    graph.set(node.inputs[0], reroute.outputs[0])
    muted = graph.node("ShaderNodeMath", {0: node.outputs[0], 1: 5.0}, operation="MULTIPLY", mute=True)
    return muted.outputs[0]
