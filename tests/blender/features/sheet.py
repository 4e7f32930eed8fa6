"""Nodes alone: planes emit their outputs, at 32 x 32 points each, which are compared number by number.

Many planes make one sheet, so that kernels are compiled once for all of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import bpy
import numpy as np

from raybatch_addon.core.shading.sampling import FILTER_TABLE_SIZE
from raybatch_addon.core.wavefront import integrator
from tests.blender.features.compare import add_world, by_cycles, by_raybatch, empty_scene, set_alike, set_bounces
from tests.blender.features.graph import Graph
from tests.blender.features.registry import Feature
from tests.support.blender_builders import add_mesh, material_of, node_tree

EDGE = 32  # points along a plane's edge
TOLERANCE = 1e-4  # absolute below 1, relative above
CELLS_MOST = 160  # variants of a sheet, about
# Radiance of the world behind the planes, which shows that a pixel's ray missed its plane. Cycles loses rays at edges
# between triangles
BEHIND = 1e6
BEHIND_SEEN = 500.0
MISSED_MOST = 0.03  # largest share of a cell's points that one engine alone misses
# a plane's corners in its own space; z varies too
_CORNERS = [(x, y, x / 2 - y / 4) for x, y in ((-2, -2), (2, -2), (2, 2), (-2, 2))]


@dataclass
class Cell:
    """One output of one variant of a feature."""

    feature: Feature
    label: str
    plane_index: int
    material: str
    ours: np.ndarray | None = None  # [EDGE, EDGE, 3], bottom row first
    theirs: np.ndarray | None = None

    @property
    def errors(self) -> np.ndarray:
        """Error of each point, [EDGE, EDGE]."""
        difference = np.abs(self.ours - self.theirs) / np.maximum(1.0, np.abs(self.theirs))
        difference = np.where(np.isfinite(self.theirs) & np.isfinite(self.ours), difference, np.inf).max(-1)
        missed = self.missed
        if np.mean(missed[0] != missed[1]) > MISSED_MOST:
            return np.where(missed[0] != missed[1], np.inf, difference)
        return np.where(missed.any(0), 0.0, difference)

    @property
    def missed(self) -> np.ndarray:
        """Whether each engine's ray missed the plane, bool [2, EDGE, EDGE]."""
        return np.stack([each.max(-1) > BEHIND_SEEN for each in (self.ours, self.theirs)])

    @property
    def worst(self) -> float:
        """The largest error."""
        return float(self.errors.max())

    @property
    def empty(self) -> bool:
        """Whether Cycles shows nothing at the points, or a single value of a node that should vary."""
        seen = self.theirs[~self.missed[1]]
        return seen.size == 0 or (not self.feature.flat and float(np.ptp(seen, axis=0).max()) < 1e-6)


def _outputs(feature: Feature, variant: Any, graph: Graph) -> dict[str, bpy.types.NodeSocket]:
    made = feature.build(graph) if variant is None else feature.build(graph, variant)
    if isinstance(made, bpy.types.NodeSocket):
        made = {made.identifier: made}
    return made


def _plane(name: str, grid_position: tuple[int, int]) -> bpy.types.Object:
    obj = add_mesh(name, _CORNERS, [(0, 1, 2, 3)])
    layer = obj.data.uv_layers.new(name="UVMap")
    for loop, (u, v) in zip(layer.data, ((0, 0), (1, 0), (1, 1), (0, 1))):
        loop.uv = (u, v)
    obj.scale = (0.5, 0.5, 0.5)
    obj.location = (2 * grid_position[0], 2 * grid_position[1], 0)
    return obj


def _add_cell(feature: Feature, variant: Any, index: int, grid_position: tuple[int, int]) -> tuple[int, str, str]:
    """Number of outputs of the variant, the label of the one at `index`, and the material's name."""
    obj = _plane(feature.name, grid_position)
    material = material_of(obj, feature.name)
    tree, surface = node_tree(material)
    graph = Graph(tree, obj)
    outputs = _outputs(feature, variant, graph)
    label, socket = list(outputs.items())[index]
    value = graph.vector_math("ADD", socket, (feature.offset,) * 3) if feature.offset else socket
    graph.set(surface, graph.value("ShaderNodeEmission", {"Color": value}))
    words = [] if variant is None else list(map(str, variant)) if isinstance(variant, tuple) else [str(variant)]
    words += [label] if len(outputs) > 1 else []
    return len(outputs), " ".join(words), material.name


def build_sheet(features: list[Feature]) -> tuple[bpy.types.Scene, list[Cell]]:
    """A scene with a plane for each output of each variant."""
    wanted = [(each, variant) for each in features for variant in each.variants]
    counts = _output_counts(wanted)
    columns = math.ceil(math.sqrt(sum(counts)))
    scene = empty_scene()
    set_alike(scene, EDGE * columns)
    set_bounces(scene, 0)
    add_world(scene, BEHIND)
    scene.cycles.filter_width = 0.01
    scene.raybatch.nee = "OFF"
    camera = scene.camera
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2 * columns
    camera.location = (columns - 1, columns - 1, 10)
    cells: list[Cell] = []
    for (each, variant), count in zip(wanted, counts):
        for index in range(count):
            plane_index = len(cells)
            _, label, material = _add_cell(each, variant, index, (plane_index % columns, plane_index // columns))
            cells.append(Cell(each, label, plane_index, material))
    return scene, cells


def _output_counts(wanted: list[tuple[Feature, Any]]) -> list[int]:
    empty_scene()
    return [_add_cell(each, variant, 0, (0, 0))[0] for each, variant in wanted]


def _middles(_name: str, _width: float) -> np.ndarray:
    """A pixel filter as narrow as possible: with a single sample Cycles looks through the middles of pixels."""
    return np.zeros(FILTER_TABLE_SIZE, np.float32)


def render_sheet(scene: bpy.types.Scene, cells: list[Cell], folder: Path) -> list[str]:
    """Fill the cells; returns RayBatch's warnings. Raises `RenderFailed`."""
    theirs = by_cycles(scene, 0, 1, folder / "sheet.exr")
    with mock.patch.object(integrator, "filter_table", _middles):
        ours, warnings = by_raybatch(scene, 0, 1)
    columns = theirs.shape[1] // EDGE
    for cell in cells:
        row, column = divmod(cell.plane_index, columns)
        part = slice(EDGE * row, EDGE * row + EDGE), slice(EDGE * column, EDGE * column + EDGE)
        cell.ours, cell.theirs = ours[part] - cell.feature.offset, theirs[part] - cell.feature.offset
    return warnings


def compare_node(build: Callable[[Graph], Any], folder: Path | str = "/tmp", **more) -> float:
    """The largest difference between RayBatch and Cycles in the sockets that `build(graph)` returns.

    It returns a socket, or several by name. The difference is absolute below 1, relative above. `more` are fields of
    `Feature`.
    """
    scene, cells = build_sheet([Feature("node", "Textures", "node", build, **more)])
    for warning in render_sheet(scene, cells, Path(folder)):
        print(warning)
    return max(cell.worst for cell in cells)
