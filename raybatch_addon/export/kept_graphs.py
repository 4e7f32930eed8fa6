"""What graphs of materials, lights and worlds were compiled to by earlier exports, found again by their signatures.

A compiled graph refers to images and attributes by their indices among those of the scene. So what was asked for while
it was compiled is asked for again, and the result serves where the answers are the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import bpy

from .images.images import image_key
from .nodes.collections import Collections
from .nodes.signature import NoSignature, Signatures
from .nodes.textures.image import exported_image

T = TypeVar("T")


@dataclass(frozen=True)
class KeptGraph:
    """What a graph was compiled to, and all that it follows from."""

    signature: tuple
    made: Any
    notes: tuple[str, ...]
    asked: tuple[tuple, ...]  # `Collections.record`


_kept: dict[int, KeptGraph] = {}  # by `session_uid` of the original that owns the graph


def forget_kept() -> None:
    """Drop all that is kept."""
    _kept.clear()


class KeptGraphs:
    """Graphs of one export that may be those of an earlier one."""

    def __init__(self, collections: Collections) -> None:
        self._collections = collections
        self._signatures = Signatures()
        self.reads_elsewhere = False  # some graph has no signature: it may read places of objects

    def forget_graphs(self) -> None:
        """Keep nothing of Blender's: graphs that are asked for again are read again."""
        self._signatures = Signatures()

    def graph_signature(self, owner: bpy.types.ID, *own: Any) -> tuple | None:
        """All that the graph of `owner`, evaluated, is compiled from, with `own` beside the graph; None where that is
        not known.
        """
        try:
            graph = self._signatures.of(owner.node_tree)
        except NoSignature:
            self.reads_elsewhere = True
            return None
        return (owner.name, *own, self._collections.engine, graph)

    def graph(self, owner: bpy.types.ID, compile_it: Callable[[], T]) -> T:
        """What `compile_it()` makes of the graph of `owner`, evaluated, now, or what it made in an earlier export."""
        self._collections.begin()
        signature = self.graph_signature(owner)
        kept = self.kept(owner, signature)
        if kept is not None:
            return kept.made
        self._collections.begin()
        made = compile_it()
        self.keep_graph(owner, signature, made, [])
        return made

    def kept(self, owner: bpy.types.ID, signature: tuple | None) -> KeptGraph | None:
        """What the graph of that `signature` was compiled to; None where it must be compiled. `Collections.begin` comes
        before.
        """
        kept = None if signature is None else _kept.get(owner.original.session_uid)
        return kept if kept is not None and kept.signature == signature and self._ask_again(kept.asked) else None

    def keep_graph(self, owner: bpy.types.ID, signature: tuple | None, made: Any, notes: list[str]) -> KeptGraph | None:
        """Remember what the graph of `owner` was compiled to, of which `Collections.record` still holds what it asked
        for; where that cannot be known, or there is no signature, forget what it was before.
        """
        uid, asked, kept = owner.original.session_uid, self._collections.record, None
        if signature is None or asked is None:
            _kept.pop(uid, None)
        else:
            kept = _kept[uid] = KeptGraph(signature, made, tuple(notes), tuple(asked))
        owners = bpy.data.materials, bpy.data.lights, bpy.data.worlds
        if len(_kept) > sum(map(len, owners)):
            there = {each.session_uid for each_kind in owners for each in each_kind}
            for gone in _kept.keys() - there:
                del _kept[gone]
        return kept

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
