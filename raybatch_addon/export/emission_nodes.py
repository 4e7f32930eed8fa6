"""What light and world node trees emit, where that is constant."""

from __future__ import annotations

import numpy as np

from .nodes.graph import NotUnderstood, constant_color, constant_float, find_source, node_label


def constant_emission(tree) -> np.ndarray:
    """Linear RGB that the tree's active output receives as emission; black where nothing is connected.

    Understands Emission, Background, Add Shader and Mix Shader with constant inputs. Raises `NotUnderstood`.
    """
    output = _output(tree)
    return np.zeros(3) if output is None else _shader(output.inputs["Surface"], ())


def has_volume(tree) -> bool:
    """Whether the tree's active output has a volume."""
    output = _output(tree)
    socket = output.inputs.get("Volume") if output else None
    return socket is not None and find_source(socket)[0] is not None


def _output(tree):
    return tree.get_output_node("CYCLES") or tree.get_output_node("ALL")


def _shader(socket, groups) -> np.ndarray:
    source, _ = find_source(socket, groups)
    if source is None:
        return np.zeros(3)
    node, groups = source.node, source.groups
    if node.bl_idname in ("ShaderNodeEmission", "ShaderNodeBackground"):
        return np.array(constant_color(node.inputs["Color"], groups)) * constant_float(node.inputs["Strength"], groups)
    if node.bl_idname == "ShaderNodeAddShader":
        return _shader(node.inputs[0], groups) + _shader(node.inputs[1], groups)
    if node.bl_idname == "ShaderNodeMixShader":
        share = np.clip(constant_float(node.inputs[0], groups), 0, 1)
        return (1 - share) * _shader(node.inputs[1], groups) + share * _shader(node.inputs[2], groups)
    raise NotUnderstood(node_label(node))
