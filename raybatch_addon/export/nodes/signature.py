"""Signatures of shader graphs: all that Blender stores of a node tree, as tuples that are equal while it is the same.

Reading a tree takes a tenth of the time that compiling it takes. The reader goes by Blender's own description of its
types and not by a list of nodes, so that what a new node stores is read too. What a graph looks up elsewhere (objects,
texts, F-curves) has no signature here: a tree that points at such a thing has none.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import bpy

from ...core.attributes import attributes_of

# Structs within structs that are followed; Blender's own are fewer
_DEPTH_MOST = 8
# Properties that lead back, or say how a node is drawn
_SKIPPED = frozenset({"rna_type", "parent", "internal_links", "inputs", "outputs", "select", "is_selected"})
# What all nodes have, which is how they are drawn but for these
_OF_NODES = ("name", "mute")


class NoSignature(Exception):
    """Raised for a tree that reads things which its signature would not hold."""


@dataclass(frozen=True)
class _Reader:
    """Properties of a type of Blender's structs, by how they are read."""

    plain: Callable[[Any], tuple]  # numbers, texts and choices, all with one call
    arrays: Callable[[Any], tuple]
    pointers: tuple[str, ...]
    collections: tuple[str, ...]


class Signatures:
    """Signatures of the trees of one export, each read once."""

    def __init__(self) -> None:
        self.images: list[tuple[Any, Any]] = []  # images and their users, as the last `of` came by them
        self._trees: dict[int, tuple[tuple, list[tuple[Any, Any]]]] = {}
        self._open: set[int] = set()

    def of(self, tree: bpy.types.NodeTree) -> tuple:
        """The signature of `tree`; raises `NoSignature`."""
        self.images = []
        return self._tree(tree)

    def _tree(self, tree: bpy.types.NodeTree) -> tuple:
        key = tree.as_pointer()
        if key not in self._trees:
            if key in self._open or tree.animation_data is not None:
                raise NoSignature
            self._open.add(key)
            outer, self.images = self.images, []
            try:
                links = tuple(
                    (each.from_node.name, each.from_socket.identifier, each.to_node.name, each.to_socket.identifier)
                    + (each.is_muted,)
                    for each in tree.links
                )
                # the interface of a group shows in the sockets of its nodes
                signature = (tree.name, tuple(map(self._node, tree.nodes)), links)
                self._trees[key] = signature, self.images
            finally:
                self._open.discard(key)
                self.images = outer
        signature, images = self._trees[key]
        self.images += images
        return signature

    def _node(self, node: bpy.types.Node) -> tuple:
        return (
            node.bl_idname,
            self._struct(node, 0),
            tuple(map(self._socket, node.inputs)),
            tuple(map(self._socket, node.outputs)),
        )

    def _socket(self, socket: bpy.types.NodeSocket) -> tuple:
        kind: type = type(socket)
        read, stored = _socket_reader(kind)
        if stored == "PLAIN":
            return (kind, *read(socket))
        own = (kind, *read(socket))
        if stored == "ARRAY":
            return (*own[:-1], tuple(own[-1]))
        if stored == "POINTER":
            return (*own[:-1], None if own[-1] is None else self._pointed(own[-1], 0))
        return own

    def _struct(self, struct: Any, depth: int) -> tuple:
        if depth > _DEPTH_MOST:
            raise NoSignature
        kind: type = type(struct)
        reader = _reader(kind)
        plain, arrays = reader.plain(struct), reader.arrays(struct)
        inner: list[Any] = []
        for name in reader.pointers:
            value = getattr(struct, name)
            if isinstance(value, bpy.types.Image):
                self.images.append((value, getattr(struct, "image_user", None)))
            inner.append(None if value is None else self._pointed(value, depth + 1))
        for name in reader.collections:
            inner.append(tuple(self._struct(each, depth + 1) for each in getattr(struct, name)))
        return (plain, tuple(map(tuple, arrays)), tuple(inner))

    def _pointed(self, value: Any, depth: int) -> tuple:
        if isinstance(value, bpy.types.NodeTree):
            return self._tree(value)
        if isinstance(value, bpy.types.Image):
            # pixels are not what a graph is compiled from
            return (value.session_uid, value.name, value.source, value.alpha_mode, value.colorspace_settings.is_data)
        if isinstance(value, bpy.types.ID):
            raise NoSignature
        return self._struct(value, depth)


@functools.cache
def _socket_reader(kind: type[bpy.types.NodeSocket]) -> tuple[Callable[[Any], tuple], str]:
    """What reads sockets of a type, their values last, and how these are stored: NONE, PLAIN, ARRAY or POINTER."""
    value = kind.bl_rna.properties.get("default_value")
    stored = "NONE"
    if value is not None:
        stored = "POINTER" if value.type == "POINTER" else "ARRAY" if getattr(value, "is_array", False) else "PLAIN"
    if value is not None and (value.type == "COLLECTION" or getattr(value, "is_enum_flag", False)):
        raise NoSignature
    values = () if stored == "NONE" else ("default_value",)
    return attrgetter("identifier", "name", "enabled", "hide_value", *values), stored


@functools.cache
def _reader(kind: type[bpy.types.bpy_struct]) -> _Reader:
    skipped = set(_SKIPPED)
    if issubclass(kind, bpy.types.Node):
        skipped |= set(bpy.types.Node.bl_rna.properties.keys()) - set(_OF_NODES)
    plain, arrays, pointers, collections = [], [], [], []
    for each in kind.bl_rna.properties:
        if each.identifier in skipped:
            continue
        if each.type == "POINTER":
            pointers.append(each.identifier)
        elif each.type == "COLLECTION":
            collections.append(each.identifier)
        elif getattr(each, "is_array", False) or getattr(each, "is_enum_flag", False):
            arrays.append(each.identifier)
        else:
            plain.append(each.identifier)
    return _Reader(attributes_of(plain), attributes_of(arrays), tuple(pointers), tuple(collections))
