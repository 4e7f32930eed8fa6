"""Input nodes alone, on smooth hills with UV coordinates, colours and attributes."""

import bpy
import numpy as np

from tests.blender.features.graph import Graph
from tests.blender.features.registry import feature
from tests.support.blender_builders import add_object

COLUMNS, ROWS = 5, 7  # faces
# Lines between faces are bent by these, so that no pixel's middle is within a thousandth of a pixel of any edge,
# however the hills are turned: on an edge two triangles would both be right
BENDS = (0.031, -0.01, 0.048, -0.041)
TURNS = (None, (0.2, 0.1, 0.4), (0.0, 0.0, 0.4), (0.0, 0.1, 0.4), (0.1, 0.0, 0.3))


def hills(graph: Graph, smooth: bool = True, turn=None) -> bpy.types.Object:
    """The plane's mesh becomes hills of 5 x 7 faces.

    Turned hills are smaller, so as not to reach into the next plane's pixels.
    """
    assert turn in TURNS
    if turn is not None:
        graph.obj.rotation_euler, graph.obj.scale = turn, (0.33, 0.33, 0.33)
    mesh = graph.obj.data
    mesh.clear_geometry()
    u, v = np.meshgrid(np.linspace(0, 1, COLUMNS + 1), np.linspace(0, 1, ROWS + 1))
    x, y = 4 * u.ravel() - 2, 4 * v.ravel() - 2
    a, b, c, d = BENDS
    x, y = x + a * (4 - x * x) * (1 + c * y), y + b * (4 - y * y) * (1 + d * x)
    z = 0.35 * np.sin(1.3 * x + 0.4) + 0.3 * np.cos(1.1 * y)
    corner = (np.arange(ROWS)[:, None] * (COLUMNS + 1) + np.arange(COLUMNS)).ravel()
    faces = np.stack([corner, corner + 1, corner + COLUMNS + 2, corner + COLUMNS + 1], 1)
    mesh.from_pydata(np.stack([x, y, z], 1).tolist(), [], faces.tolist())
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(mesh.polygons))
    if not mesh.uv_layers:
        mesh.uv_layers.new(name="UVMap")
    for loop, layer in zip(mesh.loops, mesh.uv_layers["UVMap"].data):
        position = mesh.vertices[loop.vertex_index].co
        layer.uv = (0.25 * position.x + 0.5 + 0.05 * position.y, 0.25 * position.y + 0.4)
    mesh.update()
    return graph.obj


def _input(
    name: str,
    kind: str,
    outputs: tuple[str, ...],
    quick: bool = False,
    smooth: bool = True,
    turn=None,
    offset: float = 8.0,
    **properties,
) -> None:
    @feature(name, "Inputs", "node", variants=outputs, quick=quick, flat=True, offset=offset)
    def build(graph: Graph, output: str):
        hills(graph, smooth, turn)
        return graph.value(kind, None, output, **properties)


_input("Texture Coordinate: generated and UV", "ShaderNodeTexCoord", ("Generated", "UV"), True)
_input("Texture Coordinate: normal", "ShaderNodeTexCoord", ("Normal",), turn=(0.2, 0.1, 0.4))
_input("Texture Coordinate: object", "ShaderNodeTexCoord", ("Object",), True, turn=(0.2, 0.1, 0.4))
_input("Texture Coordinate: camera and window", "ShaderNodeTexCoord", ("Camera", "Window"), offset=16.0)
_input("Texture Coordinate: reflection", "ShaderNodeTexCoord", ("Reflection",))
_input(
    "Geometry: position and normals",
    "ShaderNodeNewGeometry",
    ("Position", "Normal", "True Normal"),
    True,
    turn=(0.2, 0.1, 0.4),
)
_input("Geometry: tangent", "ShaderNodeNewGeometry", ("Tangent",), turn=(0.0, 0.0, 0.4))
_input("Geometry: incoming", "ShaderNodeNewGeometry", ("Incoming",))
_input("Geometry: parametric", "ShaderNodeNewGeometry", ("Parametric",), smooth=False)
_input("Geometry: pointiness", "ShaderNodeNewGeometry", ("Pointiness",))
_input("Object Info", "ShaderNodeObjectInfo", ("Location", "Random", "Material Index"))
_input("Camera Data", "ShaderNodeCameraData", ("View Vector", "View Z Depth", "View Distance"))
_input("Fresnel", "ShaderNodeFresnel", ("Fac",), True)
_input("Layer Weight", "ShaderNodeLayerWeight", ("Fresnel", "Facing"), True)
_input("Tangent: UV map", "ShaderNodeTangent", ("Tangent",), direction_type="UV_MAP", turn=(0.0, 0.1, 0.4))
_input(
    "Light Path: seen by the camera",
    "ShaderNodeLightPath",
    (
        "Is Camera Ray",
        "Is Shadow Ray",
        "Is Diffuse Ray",
        "Is Glossy Ray",
        "Is Singular Ray",
        "Is Reflection Ray",
        "Is Transmission Ray",
        "Ray Length",
        "Ray Depth",
        "Diffuse Depth",
        "Glossy Depth",
        "Transparent Depth",
        "Transmission Depth",
    ),
)


@feature("Texture Coordinate: of another object", "Inputs", "node")
def other_object(graph: Graph):
    hills(graph)
    other = add_object("Other", None)
    other.location, other.rotation_euler, other.scale = (1.0, 0.5, 0.3), (0.3, 0.5, 0.7), (0.8, 1.3, 0.6)
    return graph.value("ShaderNodeTexCoord", None, "Object", object=other)


@feature("Geometry: backfacing", "Inputs", "node", flat=True, variants=(False, True))
def backfacing(graph: Graph, turned: bool):
    obj = hills(graph)
    obj.scale.z = -obj.scale.z if turned else obj.scale.z
    node = graph.node("ShaderNodeNewGeometry")
    return {"Backfacing": node.outputs["Backfacing"], "Normal": node.outputs["Normal"]}


@feature("Geometry: random per island", "Inputs", "node")
def random_island(graph: Graph):
    mesh = graph.obj.data
    mesh.clear_geometry()
    corners, faces = [], []
    for i in range(5):
        left = -2 + 0.8 * i
        faces.append(tuple(range(len(corners), len(corners) + 4)))
        corners += [(left, -2, 0), (left + 0.8, -2, 0), (left + 0.8, 2, 0), (left, 2, 0)]
    mesh.from_pydata(corners, [], faces)
    return graph.value("ShaderNodeNewGeometry", output="Random Per Island")


@feature("Object Info: colour, alpha and index", "Inputs", "node", flat=True)
def object_color(graph: Graph):
    graph.obj.color, graph.obj.pass_index = (0.3, 0.6, 0.2, 0.7), 5
    node = graph.node("ShaderNodeObjectInfo")
    return {name: node.outputs[name] for name in ("Color", "Alpha", "Object Index")}


@feature("Material index", "Inputs", "node", flat=True)
def material_index(graph: Graph):
    graph.obj.data.materials[0].pass_index = 7
    return graph.value("ShaderNodeObjectInfo", output="Material Index")


@feature("UV Map", "Inputs", "node", quick=True, variants=("", "UVMap", "Second", "there is none"), flat=True)
def uv_map(graph: Graph, name: str):
    mesh = hills(graph).data
    second = mesh.uv_layers.new(name="Second")
    for loop, layer in zip(mesh.loops, second.data):
        position = mesh.vertices[loop.vertex_index].co
        layer.uv = (0.7 - 0.2 * position.y, 0.1 * position.x)
    return graph.value("ShaderNodeUVMap", None, uv_map=name)


def _attribute(mesh: bpy.types.Mesh, kind: str, domain: str) -> None:
    values = mesh.attributes.new("Values", kind, domain)
    random = np.random.default_rng(5).random((len(values.data), 4), np.float32)
    if kind == "INT":
        values.data.foreach_set("value", (10 * random[:, 0]).astype(np.int32))
    elif kind == "BOOLEAN":
        values.data.foreach_set("value", random[:, 0] > 0.5)
    elif kind == "FLOAT":
        values.data.foreach_set("value", random[:, 0])
    elif kind in ("FLOAT_VECTOR", "FLOAT2"):
        width = 3 if kind == "FLOAT_VECTOR" else 2
        values.data.foreach_set("vector", np.ascontiguousarray(random[:, :width]).ravel())
    else:
        if (kind, domain) == ("BYTE_COLOR", "CORNER"):
            # Cycles converts these from Rec. 709 to linear colours by matrices of seven digits that are not each
            # other's inverses: white becomes (1.00016, 0.99998, 0.99976). Up to here the difference is under the bound
            random[:, :3] *= 0.36
        values.data.foreach_set("color", random.ravel())


ATTRIBUTES = (
    ("FLOAT", "POINT"),
    ("FLOAT", "FACE"),
    ("FLOAT", "CORNER"),
    ("INT", "POINT"),
    ("BOOLEAN", "FACE"),
    ("FLOAT_VECTOR", "POINT"),
    ("FLOAT2", "CORNER"),
    ("FLOAT_VECTOR", "FACE"),
    ("FLOAT_COLOR", "POINT"),
    ("FLOAT_COLOR", "FACE"),
    ("BYTE_COLOR", "CORNER"),
    ("BYTE_COLOR", "POINT"),
)


@feature("Attribute: geometry", "Inputs", "node", variants=ATTRIBUTES, quick=True)
def attribute_geometry(graph: Graph, variant: tuple):
    _attribute(hills(graph).data, *variant)
    outputs = graph.outputs(graph.node("ShaderNodeAttribute", attribute_name="Values"))
    return {name: outputs[name] for name in ("Color", "Vector", "Fac")}


COLORS = (("FLOAT_COLOR", "POINT"), ("BYTE_COLOR", "CORNER"))


@feature("Attribute: alpha of a colour", "Inputs", "node", variants=COLORS)
def attribute_alpha(graph: Graph, variant: tuple):
    _attribute(hills(graph).data, *variant)
    return graph.value("ShaderNodeAttribute", None, "Alpha", attribute_name="Values")


@feature("Attribute: object", "Inputs", "node", flat=True, variants=("number", "color", "missing"))
def attribute_object(graph: Graph, name: str):
    graph.obj["number"], graph.obj["color"] = 0.375, (0.2, 0.5, 0.7)
    return graph.outputs(graph.node("ShaderNodeAttribute", attribute_type="OBJECT", attribute_name=name))


@feature(
    "Attribute: object's own properties", "Inputs", "node", flat=True, variants=("pass_index", "location", "color")
)
def attribute_object_rna(graph: Graph, name: str):
    graph.obj.pass_index = 4
    return graph.outputs(graph.node("ShaderNodeAttribute", attribute_type="OBJECT", attribute_name=name))


@feature("Attribute: view layer", "Inputs", "node", flat=True, variants=("number", "color", "missing"))
def attribute_view_layer(graph: Graph, name: str):
    scene = bpy.context.scene
    scene["number"], bpy.context.view_layer["color"] = 0.625, (0.3, 0.4, 0.8)
    return graph.outputs(graph.node("ShaderNodeAttribute", attribute_type="VIEW_LAYER", attribute_name=name))


@feature("Attribute: missing", "Inputs", "node", flat=True)
def attribute_missing(graph: Graph):
    return graph.outputs(graph.node("ShaderNodeAttribute", attribute_name="there is none"))


@feature("Color Attribute", "Inputs", "node", variants=COLORS, quick=True)
def color_attribute(graph: Graph, variant: tuple):
    _attribute(hills(graph).data, *variant)
    return graph.outputs(graph.node("ShaderNodeVertexColor", layer_name="Values"))


@feature("Tangent: radial", "Inputs", "node", variants=("X", "Y", "Z"))
def tangent_radial(graph: Graph, axis: str):
    mesh = hills(graph, turn=(0.1, 0.0, 0.3)).data
    # axes below the hills: on an axis no direction goes around it, and near it the rounding of a position decides the
    # direction
    mesh.use_auto_texspace = False
    mesh.texspace_location, mesh.texspace_size = (0, 0, -1.5), (2, 2, 2)
    return graph.value("ShaderNodeTangent", direction_type="RADIAL", axis=axis)


@feature("Wireframe", "Inputs", "node", variants=((0.12, False), (2.7, True)))
def wireframe(graph: Graph, variant: tuple):
    hills(graph, smooth=False)
    return graph.value("ShaderNodeWireframe", {0: variant[0]}, use_pixel_size=variant[1])


@feature("Fresnel and Layer Weight: linked normal", "Inputs", "node")
def linked_normal(graph: Graph):
    hills(graph)
    moved = graph.vector_math("ADD", graph.value("ShaderNodeNewGeometry", output="Normal"), (0.3, 0.1, 0.2))
    normal = graph.vector_math("NORMALIZE", moved)
    weight = graph.node("ShaderNodeLayerWeight", {"Blend": 0.3, "Normal": normal})
    fresnel = graph.value("ShaderNodeFresnel", {"IOR": 1.7, "Normal": normal})
    return {"Fresnel": fresnel, "weight": weight.outputs[0], "facing": weight.outputs[1]}
