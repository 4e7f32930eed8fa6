"""Positions of the points at which nodes are compared."""

import pytest

bpy = pytest.importorskip("bpy")

import numpy as np

from tests.blender.features.families.inputs import TURNS, hills
from tests.blender.features.graph import Graph
from tests.blender.features.sheet import EDGE, _plane


@pytest.mark.parametrize("turn", TURNS)
def test_no_point_lies_on_an_edge(turn):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    obj = hills(Graph(None, _plane("Hills", (0, 0))), turn=turn)
    bpy.context.view_layer.update()
    mesh = obj.data
    mesh.calc_loop_triangles()
    corners = np.array([obj.matrix_world @ vertex.co for vertex in mesh.vertices])[:, :2] * (EDGE / 2) + EDGE / 2
    edges = np.unique(
        np.sort([(t.vertices[i], t.vertices[i - 1]) for t in mesh.loop_triangles for i in range(3)], axis=1), axis=0
    )
    start, along = corners[edges[:, 0]], corners[edges[:, 1]] - corners[edges[:, 0]]
    middles = np.stack(np.meshgrid(np.arange(EDGE) + 0.5, np.arange(EDGE) + 0.5), -1).reshape(-1, 1, 2)
    share = np.clip(((middles - start) * along).sum(-1) / (along**2).sum(-1), 0, 1)
    distance = np.linalg.norm(middles - start - share[..., None] * along, axis=-1)
    assert distance.min() > 1e-3, "pixels"
