"""Materials of earlier exports, found again by the signatures of their graphs, or because no edit touched them."""

from __future__ import annotations

from collections.abc import Hashable, Iterable

import bpy

from ..core.scene.description import Image, Material
from .kept_graphs import KeptGraph, KeptGraphs
from .nodes.collections import Collections
from .nodes.volume_builder import reads_smoothly
from .world import has_nodes


class UntouchedMaterials:
    """Materials of a viewport's last pass: those that no edit touched since are not even looked at."""

    def __init__(self) -> None:
        self._known: dict[int, KeptGraph] = {}  # by `session_uid` of the original
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

    def find(self, material: bpy.types.Material, collections: Collections) -> KeptGraph | None:
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

    def end(self, collections: Collections, used: dict[int, KeptGraph]) -> None:
        """The pass is over, and `used` is what can be kept of it, by `session_uid`: of other materials nothing is."""
        self._known = dict(used)
        self._images = collections.images_by_key()


def is_aimed_at(material: bpy.types.Material) -> bool:
    """Whether light is aimed at what of `material` emits."""
    return emission_sampling(material) != "NONE"


def emission_sampling(material: bpy.types.Material) -> str:
    """Which sides of `material` are aimed at for their light, as Cycles names them."""
    # the setting belongs to Cycles, and is there as long as that add-on is enabled; a change of it updates no copy that
    # was evaluated
    return getattr(getattr(material.original, "cycles", None), "emission_sampling", "AUTO")


def corrects_bump(material: bpy.types.Material) -> bool:
    """Whether Cycles would turn normals of `material` that face away, and soften the edge of its shadow."""
    return getattr(getattr(material.original, "cycles", None), "use_bump_map_correction", True)


class KeptMaterials(KeptGraphs):
    """Materials of one export that may be those of an earlier one."""

    def __init__(self, collections: Collections) -> None:
        super().__init__(collections)
        self.untouched: UntouchedMaterials | None = None  # in the passes of a viewport
        self.used: dict[int, KeptGraph] = {}  # in this export, by `session_uid` of the original

    def signature(self, material: bpy.types.Material | None) -> tuple | None:
        """All that `material`, evaluated, is compiled from; None where that is not known."""
        if material is None or not has_nodes(material):
            return None
        own = material.pass_index, material.displacement_method, tuple(material.diffuse_color)
        flags = emission_sampling(material), corrects_bump(material), material.use_transparent_shadow
        return self.graph_signature(material, *own, *flags, reads_smoothly(material))

    def find_untouched(self, material: bpy.types.Material | None) -> tuple[Material, list[str]] | None:
        """Find a material as `find` does, one that no edit touched, without its signature."""
        if self.untouched is None or material is None:
            return None
        kept = self.untouched.find(material, self._collections)
        return None if kept is None else self._use(material, kept)

    def find(self, material: bpy.types.Material, signature: tuple) -> tuple[Material, list[str]] | None:
        """The material of that `signature` and the messages about it; None where it must be compiled."""
        kept = self.kept(material, signature)
        return None if kept is None else self._use(material, kept)

    def _use(self, material: bpy.types.Material, kept: KeptGraph) -> tuple[Material, list[str]]:
        self.used[material.original.session_uid] = kept
        return kept.made, list(kept.notes)

    def keep(
        self, material: bpy.types.Material | None, signature: tuple | None, compiled: Material, notes: list[str]
    ) -> None:
        """Remember what `material` was compiled to (`keep_graph`)."""
        if material is None:
            return
        kept = self.keep_graph(material, signature, compiled, notes)
        if kept is not None:
            self.used[material.original.session_uid] = kept
