"""Normals bent until mirrored directions are above the triangle, and bent normals that must leak no light."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.shading.bsdf.materials import ShadingFrame
from raybatch_addon.core.shading.bsdf.normals import bump_shadow, facet_normal
from tests.support.under_test import DEVICE


@wp.kernel(**KERNEL_OPTIONS)
def probe(normals: wp.array(dtype=wp.vec3), wo: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    frame = ShadingFrame()
    frame.geometric_normal = wp.vec3(0.0, 0.0, 1.0)
    out[i] = facet_normal(normals[i], frame, wo[i])


def bent(normals, wo):
    out = wp.zeros(len(normals), dtype=wp.vec3, device=DEVICE)
    inputs = [wp.array(each, dtype=wp.vec3, device=DEVICE) for each in (normals, wo)]
    wp.launch(probe, len(normals), [*inputs, out], device=DEVICE)
    return out.numpy().astype(float)


def directions(count, seed):
    v = np.random.default_rng(seed).normal(size=(count, 3))
    v[:, 2] = np.abs(v[:, 2])
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_mirrored_directions_are_above_the_triangle():
    n, wo = directions(20_000, 1), directions(20_000, 2)
    found = bent(n, wo)
    assert np.linalg.norm(found, axis=1) == pytest.approx(1, abs=1e-5)

    def height(normal):
        return 2 * (normal * wo).sum(1) * normal[:, 2] - wo[:, 2]

    least = np.minimum(0.9 * wo[:, 2], 0.01)
    assert (height(found) >= least - 1e-4).all()
    kept = height(n) >= least + 1e-5
    assert kept.any() and (~kept).any()
    assert found[kept] == pytest.approx(n[kept], abs=1e-6)


@pytest.mark.parametrize("z", [1e-30, 1e-6, 1.0])
def test_grazing_directions_and_the_triangles_own_normal(z):
    wo = np.array([[np.sqrt(1 - z * z), 0, z]])
    assert bent(np.array([[0.0, 0, 1]]), wo) == pytest.approx(np.array([[0, 0, 1]]))
    assert np.isfinite(bent(np.array([[-1.0, 0, 0]]), wo)).all()


@wp.kernel(**KERNEL_OPTIONS)
def shadow_probe(normals: wp.array(dtype=wp.vec3), wi: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
    i = wp.tid()
    frame = ShadingFrame()
    frame.normal = wp.vec3(0.0, 0.0, 1.0)
    out[i] = bump_shadow(normals[i], frame, wi[i])


def test_light_on_one_side_of_either_normal_alone_does_not_count():
    rows = np.random.default_rng(3).normal(size=(2, 20_000, 3))
    n, wi = rows / np.linalg.norm(rows, axis=2, keepdims=True)
    out = wp.zeros(len(n), dtype=float, device=DEVICE)
    inputs = [wp.array(each, dtype=wp.vec3, device=DEVICE) for each in (n, wi)]
    wp.launch(shadow_probe, len(n), [*inputs, out], device=DEVICE)
    left, leaks = out.numpy(), n[:, 2] * wi[:, 2] * (n * wi).sum(1) < 0
    assert not left[leaks].any() and (left[~leaks] > 0).all() and (left <= 1).all()
