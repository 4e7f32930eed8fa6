"""Following the links of a shader graph: through reroutes, muted nodes and node groups, to the node that feeds a socket."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

# Groups within groups, and sockets on the way of one link: more of them is a cycle
_GROUPS_MOST = 64
_HOPS_MOST = 1000


@dataclass(frozen=True)
class Source:
    """An output socket, and the group nodes within which its node lies, outermost first."""

    socket: Any
    groups: tuple[Any, ...] = ()
    through: tuple[str, ...] = ()  # types of the sockets of groups and muted nodes on the way: values are converted at each

    @property
    def node(self) -> Any:
        """The node of the socket."""
        return self.socket.node


def node_label(node) -> str:
    """How messages name a node."""
    return f"node “{node.name}” ({node.bl_label})"


def find_source(socket, groups: tuple[Any, ...] = (), note: Callable[[str], None] = lambda text: None) -> tuple[Source | None, Any]:
    """What feeds the input `socket`: (source, None), or (None, input socket) whose own value counts.

    `groups` are the group nodes around the socket. The input socket returned is `socket` itself, or that of
    a group node around it; None where a muted node or an unfinished group passes nothing on. `note` is told of
    groups and links that are broken.
    """
    start = socket.node
    through: list[str] = []
    for _ in range(_HOPS_MOST):
        links = [link for link in socket.links if not link.is_muted]
        link = next((link for link in links if link.is_valid), None)
        if link is None:
            if links:
                what = f"the link to input “{socket.name}” of {node_label(socket.node)}"
                note(f"{what} is invalid to Blender, as part of a circle or between unlike sockets: it is ignored")
            return None, socket
        node, output = link.from_node, link.from_socket
        if node.mute:
            passed = next((inner.from_socket for inner in node.internal_links if inner.to_socket == output), None)
            if passed is None:
                return None, None
            socket = passed
            through.append(socket.type)
        elif node.bl_idname == "NodeReroute":
            socket = node.inputs[0]
        elif node.bl_idname == "NodeGroupInput":
            socket = _by_identifier(groups[-1].inputs, output.identifier)
            groups = groups[:-1]
            if socket is None:
                return None, None
            through.append(socket.type)
        elif node.bl_idname == "ShaderNodeGroup":
            inner = _group_output(node)
            if inner is None:
                what = "has no node tree" if node.node_tree is None else "has no Group Output node"
                note(f"{node_label(node)} {what}: nothing comes out of it")
                return None, None
            socket = _by_identifier(inner.inputs, output.identifier)
            groups = (*groups, node)
            if socket is None:
                return None, None
            if len(groups) > _GROUPS_MOST:
                note(f"{node_label(groups[0])} holds groups within groups without end: nothing comes out of it")
                return None, None
            through.append(socket.type)
        else:
            return Source(output, groups, tuple(reversed(through))), None
    note(f"{node_label(start)} is linked to reroutes or muted nodes that go round in a circle: the link is ignored")
    return None, None


def _group_output(group):
    if group.node_tree is None:
        return None
    outputs = [node for node in group.node_tree.nodes if node.bl_idname == "NodeGroupOutput"]
    return next((node for node in outputs if node.is_active_output), None)


def _by_identifier(sockets, identifier: str):
    return next((socket for socket in sockets if socket.identifier == identifier), None)
