"""What a node gives in Cycles for exactly known inputs.

Each pixel sees one face of a plane, and inputs are attributes of faces: they reach the node unchanged, whatever their
size.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

import bpy
import numpy as np

from tests.blender.features.compare import by_cycles, empty_scene, set_alike, set_bounces
from tests.support.blender_builders import add_grid, node_tree

EDGE = 32
COUNT = EDGE * EDGE  # points at once


class CyclesPoints:
    """A scene that shows a node's output at `COUNT` points. The add-on is registered; opening another file ends it."""

    def __init__(self) -> None:
        self._scene = empty_scene()
        set_alike(self._scene, EDGE)
        set_bounces(self._scene, 0)
        self._scene.cycles.pixel_filter_type, self._scene.cycles.filter_width = "BOX", 0.01
        self._scene.camera.data.type, self._scene.camera.data.ortho_scale = "ORTHO", 2
        self._mesh = add_grid("Faces", EDGE).data
        self._material = bpy.data.materials.new("Node")
        self._mesh.materials.append(self._material)

    def values(
        self,
        kind: str,
        inputs: Mapping[str, object],
        output: str,
        mapping: Mapping[str, object] | None = None,
        **properties,
    ) -> np.ndarray:
        """The output of a node of `kind`, float32 [COUNT, 3].

        `inputs` by identifier: arrays [COUNT] of numbers or [COUNT, 3] of vectors and colours, or one number for all;
        what is left out keeps its default. `mapping` are properties of the node's texture mapping, `properties` its
        own.
        """
        tree, surface = node_tree(self._material)
        for attribute in [each for each in self._mesh.attributes if each.name.startswith("input ")]:
            self._mesh.attributes.remove(attribute)
        node = tree.nodes.new(kind)
        for name, value in properties.items():
            setattr(node, name, value)
        for name, value in (mapping or {}).items():
            setattr(node.texture_mapping, name, value)
        for name, value in inputs.items():
            socket = next(each for each in node.inputs if each.identifier == name)
            if np.ndim(value) == 0:
                socket.default_value = float(value)
            else:
                tree.links.new(self._source(tree, f"input {name}", np.asarray(value, np.float32)), socket)
        emission = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(next(each for each in node.outputs if each.identifier == output), emission.inputs["Color"])
        tree.links.new(emission.outputs[0], surface)
        with tempfile.TemporaryDirectory() as folder:
            return by_cycles(self._scene, 0, 1, Path(folder) / "values.exr").reshape(COUNT, 3).astype(np.float32)

    def _source(self, tree: bpy.types.NodeTree, name: str, values: np.ndarray) -> bpy.types.NodeSocket:
        attribute = self._mesh.attributes.new(name, "FLOAT_VECTOR", "FACE")
        vectors = values if values.ndim == 2 else np.repeat(values[:, None], 3, 1)
        attribute.data.foreach_set("vector", vectors.ravel())
        read = tree.nodes.new("ShaderNodeAttribute")
        read.attribute_name = name
        if values.ndim == 2:
            return read.outputs["Vector"]
        # an attribute of single numbers would be interpolated, with rounding
        parts = tree.nodes.new("ShaderNodeSeparateXYZ")
        tree.links.new(read.outputs["Vector"], parts.inputs[0])
        return parts.outputs[0]
