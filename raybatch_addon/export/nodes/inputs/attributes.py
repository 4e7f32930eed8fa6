"""Attribute, Color Attribute and UV Map: values of meshes, objects and view layers by name."""

from __future__ import annotations

from ....core.programs.builder import Value
from ..collections import OF_INSTANCER
from ..node import Node
from ..registry import values


def mesh_attribute(node: Node, kind: str, name: str, alpha_missing: int = 1) -> tuple[Value, Value, Value]:
    """Colour, number and alpha of an attribute of the mesh."""
    return node.op("attribute", node.graph.collections.attribute(kind, name), node.shift, alpha_missing)


def _outputs(color: Value, number: Value, alpha: Value) -> dict[str, Value]:
    return {"Color": color, "Vector": color, "Fac": number, "Alpha": alpha}


@values(
    "ShaderNodeAttribute", family="Inputs", note="those of geometry nodes' instances and of particles are not found"
)
def attribute(node: Node) -> dict[str, Value]:
    """An attribute by type and name."""
    name, kind = node.node.attribute_name, node.node.attribute_type
    if kind in ("OBJECT", "INSTANCER"):
        return _outputs(*node.op("object_attribute", node.graph.collections.object_attribute(kind, name)))
    if kind == "VIEW_LAYER":
        return _of_view_layer(node, name)
    if name in ("generated", "position"):
        color = node.coordinates() if name == "generated" else node.op("object_coordinates", node.shift)
        return _outputs(color, node.op("average", color), node.constant(1.0))
    if name == "N":  # this attribute alone comes in world space
        normal = node.surface_normal()
        return _outputs(normal, node.op("average", normal), node.constant(1.0))
    if name == "tangent":
        return _outputs(*mesh_attribute(node, "TANGENT", "")[:2], node.constant(1.0))
    return _outputs(*mesh_attribute(node, "GEOMETRY", name))


def _of_view_layer(node: Node, name: str) -> dict[str, Value]:
    """An attribute of the view layer, a constant."""
    collections = node.graph.collections
    collections.note_lookup()
    from ...meshes.attributes import view_layer_value  # imports Blender, without which graphs can be built

    value = None if collections.scene is None else view_layer_value(collections.scene, collections.view_layer, name)
    if value is None:
        node.warn(
            f"attribute “{name}” is 0, as the view layer, the scene and its world have none of that name; this is the "
            "type View Layer"
        )
        value = (0.0, 0.0, 0.0, 0.0)
    return _outputs(node.constant(value[:3]), node.constant(sum(value[:3]) / 3), node.constant(value[3]))


@values("ShaderNodeVertexColor", family="Inputs")
def color_attribute(node: Node) -> dict[str, Value]:
    """A colour attribute; without name the one that is marked for rendering."""
    color, _, alpha = mesh_attribute(node, "COLOR", node.node.layer_name, 0)
    return {"Color": color, "Alpha": alpha}


def of_instancer(node: Node, name: str) -> Value:
    """Position of the instance on the surface that places it, `generated` or `uv`; 0 for other objects."""
    return node.op("object_attribute", node.graph.collections.object_attribute(OF_INSTANCER, name))[0]


@values("ShaderNodeUVMap", family="Inputs")
def uv_map(node: Node) -> Value:
    """A UV map; without name the one that is marked for rendering."""
    if node.node.from_instancer:
        return of_instancer(node, "uv")
    if not node.node.uv_map:
        return node.uv()
    return mesh_attribute(node, "GEOMETRY", node.node.uv_map)[0]
