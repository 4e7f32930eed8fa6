"""What light and world node trees emit, where that is constant."""

from __future__ import annotations

import numpy as np

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec. 709


class NotConstant(Exception):
    """The emission varies, or comes from nodes that are not understood; the message names the first of them."""


def constant_emission(tree) -> np.ndarray:
    """Linear RGB that the tree's active output receives as emission; black where nothing is connected.

    Understands Emission, Background, Add Shader and Mix Shader with constant inputs. Raises `NotConstant`.
    """
    output = tree.get_output_node("CYCLES") or tree.get_output_node("ALL")
    return np.zeros(3) if output is None else _shader(output.inputs["Surface"])


def has_volume(tree) -> bool:
    """Whether the tree's active output has a volume."""
    output = tree.get_output_node("CYCLES") or tree.get_output_node("ALL")
    socket = output.inputs.get("Volume") if output else None
    return socket is not None and _source(socket) is not None


def _source(socket):
    """The output socket that feeds `socket` through reroutes, or None."""
    while True:
        link = next((link for link in socket.links if link.is_valid and not link.is_muted), None)
        if link is None:
            return None
        if link.from_node.bl_idname != "NodeReroute":
            return link.from_socket
        socket = link.from_node.inputs[0]


def _shader(socket) -> np.ndarray:
    source = _source(socket)
    if source is None:
        return np.zeros(3)
    node = source.node
    if node.mute:
        # a muted node passes its first shader on; emitters have none
        shaders = [s for s in node.inputs if s.type == "SHADER"]
        return _shader(shaders[0]) if shaders else np.zeros(3)
    if node.bl_idname in ("ShaderNodeEmission", "ShaderNodeBackground"):
        return _color(node.inputs["Color"]) * _value(node.inputs["Strength"])
    if node.bl_idname == "ShaderNodeAddShader":
        return _shader(node.inputs[0]) + _shader(node.inputs[1])
    if node.bl_idname == "ShaderNodeMixShader":
        share = np.clip(_value(node.inputs[0]), 0, 1)
        return (1 - share) * _shader(node.inputs[1]) + share * _shader(node.inputs[2])
    raise NotConstant(f"node “{node.name}” ({node.bl_label})")


def _color(socket) -> np.ndarray:
    source = _source(socket)
    if source is None:
        return np.array(socket.default_value[:3], float)
    if source.node.bl_idname == "ShaderNodeRGB" and not source.node.mute:
        return np.array(source.default_value[:3], float)
    return np.full(3, _value_node(source))


def _value(socket) -> float:
    source = _source(socket)
    if source is None:
        return float(socket.default_value)
    if source.node.bl_idname == "ShaderNodeRGB" and not source.node.mute:
        return float(np.array(source.default_value[:3]) @ _LUMINANCE)
    return _value_node(source)


def _value_node(source) -> float:
    if source.node.bl_idname == "ShaderNodeValue" and not source.node.mute:
        return float(source.default_value)
    raise NotConstant(f"node “{source.node.name}” ({source.node.bl_label})")
