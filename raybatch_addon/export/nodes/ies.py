"""IES Texture: how much light a lamp sends in every direction, by a photometric file."""

from __future__ import annotations

from ...core.shading.ies_profile import ProfileError, parse_profile
from ...core.shading.nodes.builder import Value
from ...core.shading.nodes.ies import WITHOUT_PROFILE
from ...core.shading.nodes.math import MathOperation
from ...core.shading.nodes.spaces import Space, VectorKind
from .graph import node_label
from .node import Node
from .registry import values

# What is read of a file at most [bytes]
_SIZE_MOST = 2**24
_WITHOUT = f"it gives {WITHOUT_PROFILE:g} times its strength everywhere, as in Cycles"


@values("ShaderNodeTexIES", family="Textures")
def ies_texture(node: Node) -> Value:
    """Intensity in a direction; where nothing is linked, in that of the light that leaves, seen from the object."""
    settings = node.node
    direction = node.vector("Vector") if node.linked("Vector") else _outgoing(node)
    strength = node.number("Strength")
    try:
        profile = parse_profile(_text(node))
    except (ProfileError, OSError) as error:
        node.graph.note(f"{node_label(settings)}: {_source(node)} cannot be used ({_reason(error)}); {_WITHOUT}")
        return node.op("math", MathOperation.MULTIPLY, False, strength, WITHOUT_PROFILE, 0.0)
    return node.op("ies", profile.table, len(profile.horizontal), len(profile.vertical), direction, strength)


def _outgoing(node: Node) -> Value:
    return node.op("vector_transform", VectorKind.NORMAL, Space.WORLD, Space.OBJECT, node.op("normals")[2])


def _text(node: Node) -> str:
    """The file, or the text block. Raises `OSError`, or `ProfileError` where none is named."""
    settings = node.node
    if settings.mode == "INTERNAL":
        if settings.ies is None:
            raise ProfileError("none is chosen")
        return settings.ies.as_string()
    if not settings.filepath:
        raise ProfileError("none is chosen")
    with open(_path(node), "rb") as file:
        return file.read(_SIZE_MOST).decode("latin-1")


def _path(node: Node) -> str:
    import bpy  # without which graphs can be built

    return bpy.path.abspath(node.node.filepath, library=node.library)


def _source(node: Node) -> str:
    settings = node.node
    if settings.mode == "INTERNAL":
        return f"its text “{settings.ies.name}”" if settings.ies is not None else "its text"
    return f"its file “{_path(node)}”" if settings.filepath else "its file"


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)
