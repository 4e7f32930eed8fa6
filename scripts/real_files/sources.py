"""The sources of light of an open .blend, each alone: lamps one by one, the world, and all surfaces that emit.

What lights a picture adds up: the picture of all sources is the sum of the pictures of each, whatever the engine. So an
engine whose pictures do not add up is wrong.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import bpy

from raybatch_addon.core.errors import SceneError
from raybatch_addon.export.world import has_nodes

# Sockets that make a shader emit, by the node's type, and those of the strengths among them: 0 there is no light
_EMITTING = {
    "EMISSION": ("Strength",),
    "BACKGROUND": ("Strength",),
    "BSDF_PRINCIPLED": ("Emission Strength",),
    "PRINCIPLED_VOLUME": ("Emission Strength", "Blackbody Intensity"),
    "EEVEE_SPECULAR": ("Emissive Color",),
}
WORLD, SURFACES = "the world", "surfaces that emit"


@dataclass(frozen=True)
class Source:
    """Something that gives light."""

    name: str
    turn_off: Callable[[], None]


def sources_of(scene: bpy.types.Scene) -> list[Source]:
    """All sources of `scene`."""
    # a full name says which library a lamp is of: several may have lamps of one name
    found = [Source(f"lamp “{lamp.name_full}”", functools.partial(_hide, lamp)) for lamp in _lamps(scene)]
    if scene.world is not None:
        found.append(Source(WORLD, lambda: _darken_world(scene.world)))
    if any(_emitting_sockets(tree) or _colors_as_shaders(tree) for tree in _material_trees()):
        found.append(Source(SURFACES, _darken_surfaces))
    return found


def leave_alone(scene: bpy.types.Scene, source: str) -> None:
    """Turn off all sources but the one called `source`. They cannot be turned on again: open the file anew.

    Raises `SceneError` for one that an animation turns on again.
    """
    for each in sources_of(scene):
        if each.name != source:
            each.turn_off()
    scene.frame_set(scene.frame_current)
    for each in sources_of(scene):
        if each.name not in (source, WORLD):
            raise SceneError(
                f"{each.name} cannot be turned off, as its visibility or strength is animated: delete that animation "
                "in a copy of the file to judge it by its sources"
            )


def _full_name(item: bpy.types.ID) -> str:
    return item.name_full


def _lamps(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Lamps that the scene renders, and those that no scene has: instances of collections may show them."""
    shown = set()
    for layer in scene.view_layers:
        if layer.use:
            shown |= _rendered_collections(layer.layer_collection)
    return sorted(
        (
            each
            for each in bpy.data.objects
            if each.type == "LIGHT"
            and not each.hide_render
            and (not each.users_scene or not shown.isdisjoint(each.users_collection))
        ),
        key=_full_name,
    )


def _rendered_collections(layer: bpy.types.LayerCollection) -> set[bpy.types.Collection]:
    """The collection of `layer` and those in it, without those that are not rendered."""
    if layer.exclude or layer.collection.hide_render:
        return set()
    return {layer.collection}.union(*(_rendered_collections(child) for child in layer.children))


def _hide(lamp: bpy.types.Object) -> None:
    lamp.hide_render = True


def _darken_world(world: bpy.types.World) -> None:
    """Take the light of the world's surface away; its volume stays."""
    if not has_nodes(world):
        world.color = (0, 0, 0)
        return
    for node in world.node_tree.nodes:
        if node.type == "OUTPUT_WORLD":
            for link in list(node.inputs["Surface"].links):
                world.node_tree.links.remove(link)


def _material_trees() -> list[bpy.types.NodeTree]:
    """Graphs of all materials, and those of their groups."""
    waiting = [each.node_tree for each in bpy.data.materials if each.node_tree is not None and each.users]
    found = {}
    while waiting:
        tree = waiting.pop()
        if tree.session_uid in found:
            continue
        found[tree.session_uid] = tree
        waiting += [node.node_tree for node in tree.nodes if node.type == "GROUP" and node.node_tree is not None]
    return list(found.values())


def _emitting_sockets(tree: bpy.types.NodeTree) -> list[bpy.types.NodeSocket]:
    sockets = []
    for node in tree.nodes:
        for name in _EMITTING.get(node.type, ()):
            socket = node.inputs.get(name)
            if socket is not None and (socket.is_linked or _is_bright(socket)):
                sockets.append(socket)
    return sockets


def _is_bright(socket: bpy.types.NodeSocket) -> bool:
    value = socket.default_value
    return any(value[:3]) if hasattr(value, "__len__") else value != 0


def _colors_as_shaders(tree: bpy.types.NodeTree) -> list[bpy.types.NodeLink]:
    """Links by which a colour is a shader: Cycles takes it for one that emits."""
    return [
        link
        for link in tree.links
        if link.to_socket.type == "SHADER" and link.from_socket.type not in ("SHADER", "CUSTOM")
    ]


def _darken_surfaces() -> None:
    for tree in _material_trees():
        for link in _colors_as_shaders(tree):
            tree.links.remove(link)
        for socket in _emitting_sockets(tree):
            for link in list(socket.links):
                tree.links.remove(link)
            socket.default_value = (0, 0, 0, 1) if hasattr(socket.default_value, "__len__") else 0
