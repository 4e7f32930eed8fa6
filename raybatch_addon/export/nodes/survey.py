"""Facts of a graph as the user made it, which Blender's simplification of it does not show."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from .graph import SocketLinks, find_source

_VALUE = ".default_value"


@dataclass
class Survey:
    """Facts of all nodes that feed an output, by the names that the user knows; nodes of one name count as one."""

    # (node, identifier) of inputs whose value may change by nodes, F-curves or drivers
    lively: set[tuple[str, str]] = field(default_factory=set)
    libraries: dict[str, Any] = field(default_factory=dict)  # libraries of nodes in trees of other files


def surveyed(output, note: Callable[[str], None], links: SocketLinks) -> Survey:
    """Survey of the nodes on the way to the node `output`.

    `note` is called with a message about each link or group that is broken.
    """
    survey = Survey()
    animated = _Animated()
    seen = set()
    waiting: list[tuple[Any, tuple[Any, ...]]] = [(output, ())]
    while waiting:
        node, groups = waiting.pop()
        key = (node.as_pointer(), *(group.as_pointer() for group in groups))
        if key in seen:
            continue
        seen.add(key)
        if node.id_data.library is not None:
            survey.libraries[node.name] = node.id_data.library
        moving = animated.any_in(node.id_data) or any(animated.any_in(group.id_data) for group in groups)
        for socket in node.inputs:
            own = socket
            if links.of(socket):
                source, own = find_source(socket, groups, note, links)
                if source is not None:
                    waiting.append((source.node, source.groups))
                    survey.lively.add((node.name, socket.identifier))
                    continue
            if moving and (animated.moves(socket) or (own is not None and animated.moves(own))):
                survey.lively.add((node.name, socket.identifier))
    return survey


class _Animated:
    """Sockets whose values have F-curves or drivers, by tree."""

    def __init__(self) -> None:
        self._trees: dict[int, set[int]] = {}

    def any_in(self, tree) -> bool:
        """Whether `tree` has such sockets."""
        return bool(self._of(tree))

    def moves(self, socket) -> bool:
        """Whether the value of `socket` has F-curves or drivers."""
        return socket.as_pointer() in self._of(socket.id_data)

    def _of(self, tree) -> set[int]:
        key = tree.as_pointer()
        if key not in self._trees:
            self._trees[key] = set(_animated_sockets(tree))
        return self._trees[key]


def _animated_sockets(tree) -> Iterator[int]:
    for path in animated_paths(tree):
        if path.endswith(_VALUE):
            try:
                yield tree.path_resolve(path[: -len(_VALUE)]).as_pointer()
            except ValueError:  # the path is of a node that is gone
                continue


def animated_paths(datablock) -> Iterator[str]:
    """Paths of the properties of `datablock` with drivers, or F-curves in its action or strips."""
    data = datablock.animation_data
    if data is None:
        return
    yield from (driver.data_path for driver in data.drivers)
    used = [(data.action, getattr(data, "action_slot", None))]
    used += [(strip.action, getattr(strip, "action_slot", None)) for track in data.nla_tracks for strip in track.strips]
    for action, slot in used:
        if action is None:
            continue
        if slot is None:  # Blender before 4.4
            yield from (curve.data_path for curve in getattr(action, "fcurves", ()))
            continue
        for layer in action.layers:
            for strip in layer.strips:
                bag = strip.channelbag(slot)
                yield from (curve.data_path for curve in (bag.fcurves if bag else ()))
