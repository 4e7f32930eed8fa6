"""IES Texture: the light of a lamp in every direction, by a photometric file."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.programs.ops.inputs.ies import WITHOUT_PROFILE
from ....core.programs.ops.values.math import MathOperation
from ....core.programs.ops.values.spaces import Space, VectorKind
from ....core.shading.lights.ies_profile import ProfileError, parse_profile
from ..graph import node_label
from ..node import Node
from ..registry import values

# Most bytes read of a file
_SIZE_MOST = 2**24
_WITHOUT = f"it gives {WITHOUT_PROFILE:g} times its strength everywhere, as in Cycles"


@values("ShaderNodeTexIES", family="Textures")
def ies_texture(node: Node) -> Value:
    """Intensity in a direction; without link that of the light that leaves, in object space."""
    settings = node.node
    node.graph.collections.note_lookup()
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
    """Text of the file or of the text block; raises `OSError`, or `ProfileError` if none is named."""
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
    import bpy  # imported here, since graphs can be built without Blender

    return bpy.path.abspath(node.node.filepath, library=node.library)


def _source(node: Node) -> str:
    settings = node.node
    if settings.mode == "INTERNAL":
        return f"its text “{settings.ies.name}”" if settings.ies is not None else "its text"
    return f"its file “{_path(node)}”" if settings.filepath else "its file"


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)
