"""Links of a shader graph, followed through reroutes, muted nodes and groups to the node that feeds a socket."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import bpy

# Most nested groups, and most sockets on the way of one link: more of them is a cycle
_GROUPS_MOST = 64
_HOPS_MOST = 1000
AXES = {"X": 0, "Y": 1, "Z": 2}  # as nodes name them
_GROUPS = ("GROUP", "CUSTOM GROUP")
# Blender numbers the nodes that it copies into an inlined tree
_NUMBERED = re.compile(r"^\d+_")


@dataclass(frozen=True)
class Source:
    """An output socket, and the group nodes within which its node lies, outermost first."""

    socket: bpy.types.NodeSocket
    groups: tuple[bpy.types.Node, ...] = ()
    # types of the sockets of groups and muted nodes on the way: values are converted at each
    through: tuple[str, ...] = ()

    @property
    def node(self) -> bpy.types.Node:
        """The node of the socket."""
        return self.socket.node


class SocketLinks:
    """Links by the socket that they lead to, read once for each tree.

    Blender goes through all links of a tree to find those of one socket. The links are valid until someone edits the
    trees.
    """

    def __init__(self) -> None:
        self._trees: dict[int, dict[int, list[bpy.types.NodeLink]]] = {}

    def of(self, socket) -> Sequence[bpy.types.NodeLink]:
        """The links that end in the input `socket`."""
        tree = socket.id_data
        key = tree.as_pointer()
        if key not in self._trees:
            links = self._trees[key] = {}
            for link in tree.links:
                links.setdefault(link.to_socket.as_pointer(), []).append(link)
        return self._trees[key].get(socket.as_pointer(), ())


def is_group(node) -> bool:
    """Whether `node` stands for a node tree."""
    return node.type in _GROUPS


def is_inlined(tree) -> bool:
    """Whether Blender derived the node tree `tree` from another one, without its groups and zones."""
    return tree.is_runtime_data and not tree.is_evaluated and not tree.is_embedded_data


def node_name(node) -> str:
    """The name by which the user knows a node."""
    return _NUMBERED.sub("", node.name) if is_inlined(node.id_data) else node.name


def node_label(node) -> str:
    """The name of a node in messages."""
    return f"node “{node_name(node)}” ({node.bl_label})"


def find_source(
    socket,
    groups: tuple[bpy.types.Node, ...] = (),
    note: Callable[[str], None] = lambda text: None,
    links: SocketLinks | None = None,
    keeps_values: bool = False,
) -> tuple[Source | None, Any]:
    """The output that feeds the input `socket`: (source, None), or (None, input socket) whose own value counts.

    `groups` are the group nodes around the socket. The input socket returned is `socket` itself, or that of a group
    node around it; None where the value is 0. `note` is called with a message about each group or link that is broken.
    With `keeps_values` (from Blender 5.0 on) an input keeps its own value if its link leads, by reroutes and muted
    nodes, to nothing.
    """
    links = links or SocketLinks()
    start = real = socket  # real: the last input on the way that has a value
    through: list[str] = []
    for _ in range(_HOPS_MOST):
        found = [link for link in links.of(socket) if not link.is_muted]
        link = next((link for link in found if link.is_valid), None)
        own = socket if socket is real else real if keeps_values else None
        if link is None:
            # a link to or from a socket that the node's settings hide is no mistake
            if any(link.from_socket.enabled and link.to_socket.enabled for link in found):
                what = f"the link to input “{socket.name}” of {node_label(socket.node)}"
                note(f"{what} is invalid to Blender, as part of a circle or between unlike sockets: it is ignored")
            return None, own
        node, output = link.from_node, link.from_socket
        if node.mute:
            passed = next((inner.from_socket for inner in node.internal_links if inner.to_socket == output), None)
            if passed is None:
                return None, own
            socket = passed
            through.append(socket.type)
            continue
        if node.bl_idname == "NodeReroute":
            socket = node.inputs[0]
            continue
        if node.bl_idname == "NodeGroupInput":
            socket = _by_identifier(groups[-1].inputs, output.identifier) if groups else None
            groups = groups[:-1]
        elif is_group(node):
            inner = _group_output(node)
            if inner is None:
                what = "has no node tree" if node.node_tree is None else "has no Group Output node"
                note(f"{node_label(node)} {what}: nothing comes out of it")
                return None, None
            socket = _by_identifier(inner.inputs, output.identifier)
            groups = (*groups, node)
            if len(groups) > _GROUPS_MOST:
                note(f"{node_label(groups[0])} holds groups within groups without end: nothing comes out of it")
                return None, None
        elif node.bl_idname == "ShaderNodeScript":
            note(
                f"{node_label(node)} runs a script in Open Shading Language, which is not supported: the own value of "
                "what it is linked to stands in, as in Cycles without that language"
            )
            return None, own
        else:
            return Source(output, groups, tuple(reversed(through))), None
        if socket is None:
            return None, None
        real = socket
        through.append(socket.type)
    note(f"{node_label(start)} is linked to reroutes or muted nodes that go round in a circle: the link is ignored")
    return None, None


def _group_output(group):
    if group.node_tree is None:
        return None
    outputs = [node for node in group.node_tree.nodes if node.bl_idname == "NodeGroupOutput"]
    return next((node for node in outputs if node.is_active_output), None)


def _by_identifier(sockets, identifier: str):
    return next((socket for socket in sockets if socket.identifier == identifier), None)
