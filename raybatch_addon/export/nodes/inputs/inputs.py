"""Values, coordinates, and properties of the point, its object and its ray."""

from __future__ import annotations

from ....core.programs.builder import Value
from ..graph import AXES
from ..node import Node, own_value
from ..registry import values
from ..volume_builder import is_in_volume
from .attributes import mesh_attribute, of_instancer


@values("ShaderNodeValue", "ShaderNodeRGB", family="Inputs")
def constant(node: Node) -> Value:
    """The number or colour in the node itself."""
    return own_value(node.node.outputs[0])


@values("ShaderNodeTexCoord", family="Inputs")
def texture_coordinates(node: Node) -> dict[str, Value]:
    """Coordinates by output."""
    outputs = {}
    from_instancer = node.node.from_instancer
    if node.wants("Generated"):
        outputs["Generated"] = of_instancer(node, "generated") if from_instancer else node.coordinates()
    if node.wants("Normal"):
        outputs["Normal"] = node.op("object_normal")
    if node.wants("UV"):
        outputs["UV"] = of_instancer(node, "uv") if from_instancer else node.uv()
    if node.wants("Object"):
        outputs["Object"] = _in_object(node, node.node.object)
    if node.wants("Camera"):
        outputs["Camera"] = node.op("camera_coordinates", node.shift)[3]
    if node.wants("Window"):
        outputs["Window"] = node.op("window_coordinates", node.shift)
    if node.wants("Reflection"):
        outputs["Reflection"] = node.op("reflection")
    return outputs


def _in_object(node: Node, other) -> Value:
    """The point in the space of the object itself, or of another."""
    if other is None:
        return node.op("object_coordinates", node.shift)
    matrix = other.matrix_world.inverted_safe()
    return node.op("affine", 0, node.op("position", node.shift), *(tuple(row) for row in _rows(matrix)))


def _rows(matrix) -> list[tuple[float, float, float]]:
    """Three rows of the linear part, and the offset, of an affine matrix."""
    return [tuple(matrix[i][:3]) for i in range(3)] + [(matrix[0][3], matrix[1][3], matrix[2][3])]


@values("ShaderNodeNewGeometry", family="Inputs")
def geometry(node: Node) -> dict[str, Value]:
    """The point on its surface."""
    outputs = {}
    if node.wants("Position"):
        outputs["Position"] = node.op("position", node.shift)
    if any(node.wants(name) for name in ("Normal", "True Normal", "Incoming")):
        _, outputs["True Normal"], outputs["Incoming"] = node.op("normals")
        outputs["Normal"] = node.surface_normal()
    if node.wants("Tangent"):
        outputs["Tangent"] = node.op("radial_tangent", AXES["Z"], node.shift)
    if node.wants("Parametric"):
        outputs["Parametric"] = node.op("parametric", node.shift)
    if node.wants("Backfacing"):
        outputs["Backfacing"] = node.op("backfacing")
    for name, attribute in (("Pointiness", "pointiness"), ("Random Per Island", "random_per_island")):
        if node.wants(name):
            outputs[name] = mesh_attribute(node, "GEOMETRY", attribute)[1]
    return outputs


@values("ShaderNodeObjectInfo", family="Inputs")
def object_info(node: Node) -> dict[str, Value]:
    """The object that is met, and its material."""
    outputs = {}
    if node.wants("Location"):
        outputs["Location"] = node.op("object_location")
    names = ("Color", "Alpha", "Object Index", "Random")
    if any(node.wants(name) for name in names):
        for name, value in zip(names, node.op("object_info")):
            outputs[node.output(name)] = value
    outputs["Material Index"] = node.constant(float(getattr(node.graph.owner, "pass_index", 0)))
    return outputs


@values("ShaderNodeCameraData", family="Inputs")
def camera_data(node: Node) -> dict[str, Value]:
    """The point as the camera sees it."""
    direction, depth, distance, _ = node.op("camera_coordinates", node.shift)
    return {"View Vector": direction, "View Z Depth": depth, "View Distance": distance}


@values(
    "ShaderNodeLightPath",
    family="Inputs",
    note="Portal Depth counts to 3; in worlds and lights it, depths by kind of ray and singular rays give 0",
)
def light_path(node: Node) -> dict[str, Value]:
    """The ray that met the point."""
    names = (
        "Is Camera Ray",
        "Is Shadow Ray",
        "Is Diffuse Ray",
        "Is Glossy Ray",
        "Is Reflection Ray",
        "Is Transmission Ray",
        "Ray Length",
        "Ray Depth",
        "Transparent Depth",
        "Is Volume Scatter Ray",
    )
    outputs = {node.output(name): value for name, value in zip(names, node.op("light_path"))}
    if node.wants("Portal Depth"):
        if type(node.graph.owner).__name__ == "Material":
            outputs[node.output("Portal Depth")] = node.op("portal_depth")
        else:
            node.warn("in worlds and lights Portal Depth is 0: it is not supported there; this is an output")
    # counted only if asked for
    counted = (
        "Is Diffuse Ray",
        "Is Glossy Ray",
        "Is Singular Ray",
        "Diffuse Depth",
        "Glossy Depth",
        "Transmission Depth",
    )
    if any(node.wants(name) for name in counted):
        if type(node.graph.owner).__name__ == "Material":
            outputs |= {node.output(name): value for name, value in zip(counted, node.op("path_history"))}
        else:
            for name in ("Is Singular Ray", "Diffuse Depth", "Glossy Depth", "Transmission Depth"):
                if node.wants(name):
                    node.warn(f"in worlds and lights {name} is 0: it is not supported there; this is an output")
    return outputs


@values("ShaderNodeFresnel", family="Inputs")
def fresnel(node: Node) -> Value:
    """Reflectance of a dielectric."""
    return node.op("fresnel", node.number("IOR"), node.normal())


@values("ShaderNodeLayerWeight", family="Inputs")
def layer_weight(node: Node) -> dict[str, Value]:
    """Weights for layers."""
    by_fresnel, facing = node.op("layer_weight", node.number("Blend"), node.normal())
    return {"Fresnel": by_fresnel, "Facing": facing}


@values("ShaderNodeWireframe", family="Inputs")
def wireframe(node: Node) -> Value:
    """Edges of triangles."""
    return node.op("wireframe", int(node.node.use_pixel_size), node.number("Size"))


@values("ShaderNodeParticleInfo", family="Inputs", note="gives 0, as on any mesh: particles are not supported")
def of_no_mesh(node: Node) -> Value:
    """0 for data that no mesh has."""
    node.warn("particles are not supported; 0 is the output")
    return node.constant(0.0)


@values("ShaderNodeVolumeInfo", family="Inputs")
def volume_info(node: Node) -> dict[str, Value]:
    """Grids of a volume object; 0 elsewhere."""
    if not is_in_volume(node.graph):
        return {name: node.constant(0.0) for name in ("Color", "Density", "Flame", "Temperature")}
    outputs = {}
    for name in ("Color", "Density", "Flame", "Temperature"):
        if node.wants(name):
            outputs[name] = mesh_attribute(node, "GEOMETRY", name.lower())[0 if name == "Color" else 1]
    return outputs
