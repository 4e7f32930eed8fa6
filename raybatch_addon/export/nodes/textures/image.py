"""Image and environment textures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....core.programs.ops.textures.environment import EnvironmentProjection
from ....core.programs.ops.textures.image import Projection
from ....core.shading.images.textures import Extension, Interpolation
from ..collections import Collections
from ..graph import node_label
from ..node import Node, Value
from ..registry import values
from .mapping import mapped

if TYPE_CHECKING:
    import bpy

_INTERPOLATIONS = {
    "Closest": Interpolation.CLOSEST,
    "Linear": Interpolation.LINEAR,
    "Cubic": Interpolation.CUBIC,
    "Smart": Interpolation.CUBIC,  # as in Cycles
}


@values("ShaderNodeTexImage", family="Textures")
def image_texture(node: Node) -> dict[str, Value]:
    """Colour and alpha of an image at texture coordinates; without link at the active UV map."""
    texture = node.node
    index, divide = _image_of(node)
    interpolation, extension = _INTERPOLATIONS[texture.interpolation], Extension[texture.extension]
    coordinates = mapped(node, node.vector("Vector") if node.linked("Vector") else node.uv())
    if texture.projection == "BOX":
        blend = float(texture.projection_blend)
        color, alpha = node.op(
            "image_box", index, interpolation, extension, divide, blend, coordinates, node.op("object_normal")
        )
    else:
        color, alpha = node.op(
            "image", index, interpolation, extension, Projection[texture.projection], divide, coordinates
        )
    return {"Color": color, "Alpha": alpha}


@values("ShaderNodeTexEnvironment", family="Textures")
def environment_texture(node: Node) -> dict[str, Value]:
    """Colour of an image in a direction.

    Without link the direction is that of the ray into the world, or of the point from the origin.
    """
    texture = node.node
    index, divide = _image_of(node)
    if type(node.graph.owner).__name__ == "World":
        node.graph.collections.environments.add(index)
    projection = EnvironmentProjection[texture.projection]
    direction = mapped(node, node.vector("Vector") if node.linked("Vector") else node.op("position", node.shift))
    color, alpha = node.op("environment", index, _INTERPOLATIONS[texture.interpolation], projection, divide, direction)
    return {"Color": color, "Alpha": alpha}


def _image_of(node: Node) -> tuple[int, int]:
    """Index of the node's image, and whether alpha is divided out of its colours (only if alpha is used)."""
    # imports Blender, without which graphs can be built
    from ...images.images import divides_alpha

    texture = node.node
    index = exported_image(node.graph.collections, texture.image, texture.image_user)
    if texture.image is None:
        node.graph.note(f"{node_label(texture)} has no image: it is magenta")
    return index, int(node.wants("Alpha") and divides_alpha(texture.image))


def exported_image(collections: Collections, image: bpy.types.Image | None, user: bpy.types.ImageUser | None) -> int:
    """Index of Blender's `image` at the frame of `collections`; `user` is the node's `ImageUser`."""
    from ...images.images import export_image, image_key  # imports Blender

    def make():
        exported, notes = export_image(image, user, collections.frame)
        collections.warnings += notes
        return exported

    return collections.image(image_key(image, user, collections.frame), make)
