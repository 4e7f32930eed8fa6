"""Materials of earlier exports, found again by the signatures of their graphs.

A compiled graph refers to images and attributes by their indices among those of the scene. So what was asked for while
it was compiled is asked for again, and the material serves where the answers are the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from ..core.scene.description import Material
from .images.images import image_key
from .nodes.collections import Collections
from .nodes.signature import NoSignature, Signatures
from .nodes.textures.image import exported_image
from .world import has_nodes


@dataclass(frozen=True)
class _Kept:
    signature: tuple
    material: Material
    notes: tuple[str, ...]
    asked: tuple[tuple, ...]  # `Collections.record`


_kept: dict[int, _Kept] = {}  # by `session_uid` of the original


def forget_materials() -> None:
    """Drop all materials that are kept."""
    _kept.clear()


class KeptMaterials:
    """Materials of one export that may be those of an earlier one."""

    def __init__(self, collections: Collections) -> None:
        self._collections = collections
        self._signatures = Signatures()

    def signature(self, material: bpy.types.Material | None) -> tuple | None:
        """All that `material`, evaluated, is compiled from; None where that is not known."""
        if material is None or not has_nodes(material):
            return None
        try:
            graph = self._signatures.of(material.node_tree)
        except NoSignature:
            return None
        own = (material.name, material.pass_index, material.displacement_method, tuple(material.diffuse_color))
        return (*own, self._collections.engine, graph)

    def find(self, material: bpy.types.Material, signature: tuple) -> tuple[Material, list[str]] | None:
        """The material of that `signature` and the messages about it; None where it must be compiled."""
        kept = _kept.get(material.original.session_uid)
        if kept is None or kept.signature != signature or not self._ask_again(kept.asked):
            return None
        return kept.material, list(kept.notes)

    def keep(self, material: bpy.types.Material, signature: tuple, compiled: Material, notes: list[str]) -> None:
        """Remember what `material` was compiled to, of which `Collections.record` still holds what it asked for."""
        asked = self._collections.record
        if asked is not None:
            _kept[material.original.session_uid] = _Kept(signature, compiled, tuple(notes), tuple(asked))
        if len(_kept) > len(bpy.data.materials):
            there = {each.session_uid for each in bpy.data.materials}
            for gone in _kept.keys() - there:
                del _kept[gone]

    def _ask_again(self, asked: tuple[tuple, ...]) -> bool:
        """Whether the scene gives the same indices. Where it does not, the graph asks for the same once more."""
        collections = self._collections
        images = None
        for kind, what, index in asked:
            if kind == "image":
                if images is None:
                    # nodes without an image ask too
                    users = [(None, None), *self._signatures.images]
                    images = {image_key(*each, collections.frame): each for each in users}
                if what not in images or exported_image(collections, *images[what]) != index:
                    return False
            elif getattr(collections, kind)(*what) != index:
                return False
        return True
