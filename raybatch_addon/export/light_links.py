"""Light linking: which emitters light which objects, and which objects block whose light.

Objects that the collections of all emitters name alike are one set; those that none names are set 0. A collection that
includes something lights what it includes alone; one that only excludes lights all the rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import bpy

from ..core.scene.description import ALL_LIGHT_SETS, ALL_SHADOW_SETS, COPY_SET, SHADOW_SETS
from ..core.scene.notice import Notice, Weight


@dataclass(frozen=True)
class ObjectLinks:
    """The sets of one object, and those of its own light."""

    receiver: int = 0
    blocker: int = 0
    lights: int = ALL_LIGHT_SETS
    shadows: int = ALL_SHADOW_SETS


class LightLinking:
    """The links of all objects of a scene."""

    def __init__(self, objects: Iterator[bpy.types.Object], warnings: list[str]) -> None:
        """`objects`: all that are rendered, original."""
        emitters = [(obj, obj.light_linking) for obj in objects if getattr(obj, "light_linking", None)]
        receivers = _Sets("receiver", [links.receiver_collection for _, links in emitters], COPY_SET, warnings)
        blockers = _Sets("blocker", [links.blocker_collection for _, links in emitters], SHADOW_SETS, warnings)
        self._emitters = {
            obj.as_pointer(): (
                receivers.lit_by(links.receiver_collection) | 1 << COPY_SET,
                blockers.lit_by(links.blocker_collection),
            )
            for obj, links in emitters
        }
        self._receiver_of, self._blocker_of = receivers.of, blockers.of
        self.links_lights, self.links_shadows = receivers.count > 1, blockers.count > 1

    def __bool__(self) -> bool:
        return self.links_lights or self.links_shadows

    def of(self, obj: bpy.types.Object, parent: bpy.types.Object | None = None) -> ObjectLinks:
        """The links of `obj`, original, which `parent` places if it is an instance."""
        lights, shadows = self._emitters.get(obj.as_pointer(), (ALL_LIGHT_SETS, ALL_SHADOW_SETS))
        owners = [each.as_pointer() for each in (parent, obj) if each is not None]
        receiver, blocker = (
            next((sets[owner] for owner in owners if sets.get(owner)), 0)
            for sets in (self._receiver_of, self._blocker_of)
        )
        return ObjectLinks(receiver, blocker, lights, shadows)


class _Sets:
    """Sets of objects that some collections name alike."""

    def __init__(
        self, what: str, collections: list[bpy.types.Collection | None], most: int, warnings: list[str]
    ) -> None:
        self.of: dict[int, int] = {}  # set by pointer of an object
        self._all = (1 << most) - 1
        self._numbers = {each.as_pointer(): i for i, each in enumerate(dict.fromkeys(filter(None, collections)))}
        states: dict[int, dict[int, str]] = {}  # by object, then by collection
        names: dict[int, str] = {}
        self._includes: set[int] = set()
        for collection in dict.fromkeys(filter(None, collections)):
            number = self._numbers[collection.as_pointer()]
            for obj, state in _members(collection):
                known = states.setdefault(obj.as_pointer(), {})
                known[number] = "EXCLUDE" if "EXCLUDE" in (state, known.get(number)) else state
                names[obj.as_pointer()] = obj.name
                if state == "INCLUDE":
                    self._includes.add(number)
        kinds: dict[tuple, int] = {(): 0}
        left: list[str] = []
        for obj, known in states.items():
            key = tuple(sorted(known.items()))
            if key not in kinds and len(kinds) == most:
                left.append(names[obj])
                continue
            self.of[obj] = kinds.setdefault(key, len(kinds))
        self._kinds, self.count = kinds, len(kinds)
        if left:
            listed = ", ".join(f"“{name}”" for name in left)
            text = f"light linking has more than {most} different sets of {what}s; these are as if none named them: "
            warnings.append(Notice(text + listed, Weight.REPLACED, objects=left))

    def lit_by(self, collection: bpy.types.Collection | None) -> int:
        """Bits of the sets that belong to an emitter with `collection`."""
        if collection is None:
            return self._all
        number = self._numbers[collection.as_pointer()]
        by_default = number not in self._includes
        bits = 0
        for key, index in self._kinds.items():
            state = dict(key).get(number)
            if state == "INCLUDE" or (state is None and by_default):
                bits |= 1 << index
        if by_default:  # and all sets that there are not
            bits |= self._all & ~((1 << self.count) - 1)
        return bits


def _members(collection: bpy.types.Collection) -> Iterator[tuple[bpy.types.Object, str]]:
    """Objects that `collection` names, also through collections in it, and whether it includes or excludes them."""
    for child, linked in zip(collection.children, collection.collection_children, strict=True):
        for obj in child.all_objects:
            yield obj, linked.light_linking.link_state
    for obj, linked in zip(collection.objects, collection.collection_objects, strict=True):
        yield obj, linked.light_linking.link_state
