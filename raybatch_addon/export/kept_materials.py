"""Materials of earlier exports, found again by the signatures of their graphs.

A compiled graph refers to images and attributes by their indices among those of the scene. So what was asked for while
it was compiled is asked for again, and the material serves where the answers are the same.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass

import bpy

from ..core.scene.description import Image, Material
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


class UntouchedMaterials:
    """Materials of a viewport's last pass: those that no edit touched since are not even looked at."""

    def __init__(self) -> None:
        self._known: dict[int, _Kept] = {}  # by `session_uid` of the original
        self._images: dict[Hashable, Image] = {}  # by what `Collections.image` knows them as
        self._reported: tuple[str, int] | None = None  # what all of them follow from

    def forget(self, touched: Iterable[int] | None = None) -> None:
        """Materials of these `session_uid`s are others now; None: any may be."""
        if touched is None:
            self._known.clear()
            self._images.clear()
            return
        for uid in touched:
            self._known.pop(uid, None)

    def begin(self, collections: Collections) -> None:
        """A pass begins, which asks `collections`."""
        reported = (collections.engine, collections.frame)
        if reported != self._reported:
            self.forget()
            self._reported = reported

    def find(self, material: bpy.types.Material, collections: Collections) -> _Kept | None:
        """`material` as it was, if nothing touched it and the scene gives the same indices."""
        known = self._known.get(material.original.session_uid)
        if known is None:
            return None
        for kind, what, index in known.asked:
            if kind == "image":
                if what not in self._images or collections.image(what, lambda what=what: self._images[what]) != index:
                    return None
            elif getattr(collections, kind)(*what) != index:
                return None
        return known

    def end(self, collections: Collections, used: dict[int, _Kept]) -> None:
        """The pass is over, and `used` is what can be kept of it, by `session_uid`: of other materials nothing is."""
        self._known = dict(used)
        self._images = collections.images_by_key()


def is_aimed_at(material: bpy.types.Material) -> bool:
    """Whether light is aimed at what of `material` emits."""
    # the setting belongs to Cycles, and is there as long as that add-on is enabled; a change of it updates no copy that
    # was evaluated
    return getattr(getattr(material.original, "cycles", None), "emission_sampling", "AUTO") != "NONE"


def forget_materials() -> None:
    """Drop all materials that are kept."""
    _kept.clear()


class KeptMaterials:
    """Materials of one export that may be those of an earlier one."""

    def __init__(self, collections: Collections) -> None:
        self._collections = collections
        self._signatures = Signatures()
        self.untouched: UntouchedMaterials | None = None  # in the passes of a viewport
        self.used: dict[int, _Kept] = {}  # in this export, by `session_uid` of the original
        self.reads_elsewhere = False  # some graph has no signature: it may read places of objects

    def forget_graphs(self) -> None:
        """Keep nothing of Blender's: graphs that are asked for again are read again."""
        self._signatures = Signatures()

    def signature(self, material: bpy.types.Material | None) -> tuple | None:
        """All that `material`, evaluated, is compiled from; None where that is not known."""
        if material is None or not has_nodes(material):
            return None
        try:
            graph = self._signatures.of(material.node_tree)
        except NoSignature:
            self.reads_elsewhere = True
            return None
        own = (material.name, material.pass_index, material.displacement_method, tuple(material.diffuse_color))
        return (*own, is_aimed_at(material), self._collections.engine, graph)

    def find_untouched(self, material: bpy.types.Material | None) -> tuple[Material, list[str]] | None:
        """Find a material as `find` does, one that no edit touched, without its signature."""
        if self.untouched is None or material is None:
            return None
        kept = self.untouched.find(material, self._collections)
        return None if kept is None else self._use(material, kept)

    def find(self, material: bpy.types.Material, signature: tuple) -> tuple[Material, list[str]] | None:
        """The material of that `signature` and the messages about it; None where it must be compiled."""
        kept = _kept.get(material.original.session_uid)
        if kept is None or kept.signature != signature or not self._ask_again(kept.asked):
            return None
        return self._use(material, kept)

    def _use(self, material: bpy.types.Material, kept: _Kept) -> tuple[Material, list[str]]:
        self.used[material.original.session_uid] = kept
        return kept.material, list(kept.notes)

    def keep(
        self, material: bpy.types.Material | None, signature: tuple | None, compiled: Material, notes: list[str]
    ) -> None:
        """Remember what `material` was compiled to, of which `Collections.record` still holds what it asked for; where
        that cannot be known, or there is no signature, forget what it was before.
        """
        if material is None:
            return
        uid, asked = material.original.session_uid, self._collections.record
        if signature is None or asked is None:
            _kept.pop(uid, None)
        else:
            self.used[uid] = _kept[uid] = _Kept(signature, compiled, tuple(notes), tuple(asked))
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
