"""Following the links of a shader graph: through reroutes, muted nodes and node groups, to the node that feeds a socket."""

from __future__ import annotations

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


def find_source(socket, groups: tuple[Any, ...] = ()) -> tuple[Source | None, Any]:
    """What feeds the input `socket`: (source, None), or (None, input socket) whose own value counts.

    `groups` are the group nodes around the socket. The input socket returned is `socket` itself, or that of
    a group node around it; None where a muted node or an unfinished group passes nothing on.
    """
    through: list[str] = []
    for _ in range(_HOPS_MOST):
        link = next((link for link in socket.links if link.is_valid and not link.is_muted), None)
        if link is None:
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
                return None, None
            socket = _by_identifier(inner.inputs, output.identifier)
            groups = (*groups, node)
            if socket is None or len(groups) > _GROUPS_MOST:
                return None, None
            through.append(socket.type)
        else:
            return Source(output, groups, tuple(reversed(through))), None
    return None, None


def _group_output(group):
    if group.node_tree is None:
        return None
    outputs = [node for node in group.node_tree.nodes if node.bl_idname == "NodeGroupOutput"]
    return next((node for node in outputs if node.is_active_output), None)


def _by_identifier(sockets, identifier: str):
    return next((socket for socket in sockets if socket.identifier == identifier), None)
