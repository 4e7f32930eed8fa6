"""Following the links of a shader graph: through reroutes, muted nodes and node groups, to shaders and constants."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

# Groups within groups, and sockets on the way of one link: more of them is a cycle
_GROUPS_MOST = 64
_HOPS_MOST = 1000

LUMINANCE = (0.21263901, 0.71516868, 0.07219232)  # of linear Rec. 709: how Blender turns a colour into a value


class NotUnderstood(Exception):
    """A part of a graph that cannot be expressed; the message names the node."""


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


def constant_value(socket, groups: tuple[Any, ...] = ()) -> float | tuple[float, ...]:
    """The constant at the input `socket`: its own value, or that of a Value or RGB node. Raises `NotUnderstood`."""
    source, own = find_source(socket, groups)
    if source is None:
        return 0.0 if own is None else _plain(own)
    if source.node.bl_idname in ("ShaderNodeValue", "ShaderNodeRGB"):
        return _plain(source.socket)
    raise NotUnderstood(f"{node_label(source.node)}, which gives the {socket.name} of {node_label(socket.node)}")


def constant_float(socket, groups: tuple[Any, ...] = ()) -> float:
    """`constant_value` as a number, as Blender converts it."""
    value = constant_value(socket, groups)
    if isinstance(value, tuple):
        return sum(c * w for c, w in zip(value, LUMINANCE))
    return value


def constant_color(socket, groups: tuple[Any, ...] = ()) -> tuple[float, float, float]:
    """`constant_value` as linear RGB, negative channels raised to 0."""
    value = constant_value(socket, groups)
    red, green, blue = value if isinstance(value, tuple) else (value,) * 3
    return max(red, 0.0), max(green, 0.0), max(blue, 0.0)


def _plain(socket) -> float | tuple[float, float, float]:
    value = socket.default_value
    plain = tuple(float(c) for c in value[:3]) if hasattr(value, "__len__") else float(value)
    if not all(math.isfinite(c) for c in (plain if isinstance(plain, tuple) else (plain,))):
        raise NotUnderstood(f"the {socket.name} of {node_label(socket.node)} is not a finite number")
    return plain
