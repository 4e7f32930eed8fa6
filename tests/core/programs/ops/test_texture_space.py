"""Generated coordinates: even on faces across an axis of object space, wherever the object stands."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.inputs_data import upload_inputs
from raybatch_addon.core.programs.op import NodeData, op_named
from raybatch_addon.core.programs.point import ShadingPoint
from raybatch_addon.core.programs.texture_space import generated_corners
from raybatch_addon.core.scene.program import Instruction, Program
from tests.support import scenes
from tests.support.under_test import DEVICE

GENERATED = op_named("generated").function
ASKING = replace(scenes.diffuse(), program=Program((Instruction("generated", (0, 0)),)))
ROTATION = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
PLACES = {
    "turned": np.column_stack([ROTATION, [30, -20, 1000]]).astype(np.float32),
    "mirrored": np.column_stack([ROTATION @ np.diag([-3, 0.1, 2]), [5, 6, 7]]).astype(np.float32),
}


@wp.kernel(**KERNEL_OPTIONS)
def generated_probe(data: NodeData, barycentric: wp.array(dtype=wp.vec2), out: wp.array2d(dtype=wp.vec3)):
    triangle, i = wp.tid()
    point = ShadingPoint()
    point.primitive = triangle
    point.barycentric = barycentric[i]
    point.position = wp.vec3(wp.nan)  # not read
    stack = wp.zeros(3, dtype=float)
    GENERATED(data, stack, 0, point)
    out[triangle, i] = wp.vec3(stack[0], stack[1], stack[2])


def generated_at(scene, triangles: int, barycentric: np.ndarray) -> np.ndarray:
    """Generated coordinates of points of the first instance, float32, shape [triangles, points, 3]."""
    data = NodeData()
    data.inputs = upload_inputs(scene, ("generated",), DEVICE)
    data.code = wp.array([0, 0, 0], dtype=int, device=DEVICE)
    out = wp.zeros((triangles, len(barycentric)), dtype=wp.vec3, device=DEVICE)
    wp.launch(
        generated_probe, out.shape, [data, wp.array(barycentric, dtype=wp.vec2, device=DEVICE), out], device=DEVICE
    )
    return out.numpy()


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("copies", [1, 2])
def test_faces_across_an_axis_have_one_coordinate_to_the_last_bit(place, copies):
    box = scenes.box(size=1.4)
    box = replace(box, texture_space=((0.0, 0.0, 0.0), (float(box.positions.max()),) * 3))
    scene = scenes.scene([(box, PLACES[place], ASKING)] * copies)
    barycentric = np.random.default_rng(1).dirichlet(np.ones(3), 200)[:, 1:]
    got = generated_at(scene, len(box.triangles), barycentric)

    flips = copies == 1 and np.linalg.det(PLACES[place][:, :3]) < 0
    corners = (
        box.positions[box.triangles[:, [0, 2, 1]] if flips else box.triangles].astype(np.float64) / np.float32(1.4)
        + 0.5
    )
    weights = np.column_stack([1 - barycentric.sum(1), barycentric])
    assert got == pytest.approx(np.einsum("pk,tkc->tpc", weights, corners), abs=1e-6)
    even = (corners == corners[:, :1]).all(1)
    assert even.sum() == len(box.triangles)  # one axis of each triangle
    at = got.transpose(0, 2, 1)[even]
    assert np.isin(at, [0.0, 1.0]).all() and (at == at[:, :1]).all()


def test_only_meshes_that_need_it_have_their_corners_kept():
    box, ball, plane = scenes.box(), scenes.sphere(), scenes.plane()
    turned = PLACES["turned"]
    kept = generated_corners(
        scenes.scene(
            [
                (box, turned, scenes.diffuse()),
                (scenes.sphere("turned"), np.column_stack([ROTATION, [0, 0, 0]]).astype(np.float32), ASKING),
                (plane, scenes.IDENTITY, ASKING),
            ]
        )
    )
    assert kept == {}
    kept = generated_corners(
        scenes.scene([(ball, turned, scenes.diffuse()), (plane, scenes.IDENTITY, ASKING), (plane, turned, ASKING)])
    )
    assert list(kept) == [1] and kept[1].shape == (2, 3, 3)
    assert (kept[1][..., 2] == 0.5).all()
