"""Warps from the unit square, and pixel filters."""

import functools
import math

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.shading.sampling import (
    bitangent_of,
    filter_table,
    sample_aperture,
    sample_cone,
    sample_cosine_hemisphere,
    sample_disk,
    sample_filter,
    sample_sphere,
    sample_triangle,
    spherical_direction,
    tangent_of,
    to_world,
)
from tests.support.under_test import BLOCK_DIM, DEVICE


def load(kernel):
    kernel.module.load(wp.get_device(DEVICE), block_dim=BLOCK_DIM)
    return kernel


def launch(kernel, count, inputs, outputs):
    wp.launch(kernel, count, inputs=inputs, outputs=outputs, device=DEVICE, block_dim=BLOCK_DIM)


@wp.kernel(**KERNEL_OPTIONS)
def warp_kernel(
    shape: int,
    parameter: float,
    count: int,
    u: wp.array(dtype=wp.vec2),
    table: wp.array(dtype=float),
    out: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    if shape == 0:
        p = sample_disk(u[i])
        out[i] = wp.vec3(p[0], p[1], 0.0)
    if shape == 1:
        out[i] = sample_cosine_hemisphere(u[i])
    if shape == 2:
        out[i] = sample_sphere(u[i])
    if shape == 3:
        out[i] = sample_cone(u[i], parameter)
    if shape == 4:
        out[i] = sample_triangle(u[i])
    if shape == 5:
        p = sample_aperture(u[i], count, parameter)
        out[i] = wp.vec3(p[0], p[1], 0.0)
    if shape == 6:
        p = sample_filter(table, u[i])
        out[i] = wp.vec3(p[0], p[1], 0.0)


DISK, COSINE, SPHERE, CONE, TRIANGLE, APERTURE, PIXEL = range(7)
ENDS = np.array(
    [(a, b) for a in (0, 2.0**-24, 0.5, 1 - 2.0**-24) for b in (0, 2.0**-24, 0.5, 1 - 2.0**-24)], np.float32
)


@functools.cache
def jittered(side):
    """One random point in each cell of the unit square [side^2, 2]."""
    x = np.arange(side)
    cells = np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    return np.minimum((cells + np.random.default_rng(0).random(cells.shape)) / side, 1 - 2.0**-24).astype(np.float32)


def warp_points(shape, parameter=0.0, count=0, u=None, table=(0.0, 0.0)):
    u = jittered(256) if u is None else u
    out = wp.zeros(len(u), dtype=wp.vec3, device=DEVICE)
    arrays = [
        wp.array(u, dtype=wp.vec2, device=DEVICE),
        wp.array(np.asarray(table, np.float32), dtype=float, device=DEVICE),
    ]
    launch(load(warp_kernel), len(u), [shape, parameter, count, *arrays], [out])
    return out.numpy().astype(np.float64)


def assert_even(values, bins, tolerance=0.02):
    """Assert that `values`, uniform in [0, 1) if the warp is right, fall evenly into `bins` (stratified input)."""
    counts = np.bincount(np.clip((values * bins).astype(int), 0, bins - 1), minlength=bins)
    np.testing.assert_allclose(counts, len(values) / bins, rtol=tolerance)


def turns(x, y):
    return np.arctan2(y, x) / (2 * np.pi) % 1.0


def test_disk_and_cosine_hemisphere():
    p = warp_points(DISK)
    r2 = p[:, 0] ** 2 + p[:, 1] ** 2
    assert r2.max() < 1
    assert_even(r2, 16)
    assert_even(turns(p[:, 0], p[:, 1]), 16)
    d = warp_points(COSINE)
    assert_even(d[:, 2] ** 2, 16)
    assert_even(turns(d[:, 0], d[:, 1]), 16)
    border = jittered(64).copy()
    border[::2, 0], border[1::2, 1] = 0, 1 - 2.0**-24
    d = np.concatenate([d, warp_points(COSINE, u=ENDS), warp_points(COSINE, u=border)])
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, atol=1e-6)
    assert d[:, 2].min() >= 2**-11.5 * (1 - 1e-6)


def test_sphere_and_cone():
    d = warp_points(SPHERE)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, atol=1e-6)
    assert_even((d[:, 2] + 1) / 2, 16)
    assert_even(turns(d[:, 0], d[:, 1]), 16)
    for half in (np.pi, 1.0, 0.005, 1e-5):
        one_minus_cos = 2 * math.sin(half / 2) ** 2
        d = np.concatenate([warp_points(CONE, one_minus_cos), warp_points(CONE, one_minus_cos, u=ENDS)])
        sine = np.hypot(d[:, 0], d[:, 1])
        if half < 1.5:
            # 1 - cos = 2 sin^2(angle / 2), from the sine: precise in the thinnest cone
            share = 2 * np.sin(np.arcsin(sine) / 2) ** 2 / one_minus_cos
            assert share.max() < 1 + 1e-5
            assert_even(share, 16)
        np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, atol=1e-6)


def test_triangle():
    b = np.concatenate([warp_points(TRIANGLE), warp_points(TRIANGLE, u=ENDS)])
    assert b.min() >= 0
    np.testing.assert_allclose(b.sum(1), 1, atol=1e-6)
    for k in range(3):  # the share below b_k = x is 1 - (1 - x)^2
        assert_even(1 - (1 - b[:, k]) ** 2, 16)


@pytest.mark.parametrize("blades", [3, 5, 6, 17])
def test_aperture_is_a_regular_polygon(blades):
    rotation, half = 0.3, np.pi / blades
    p = np.concatenate([warp_points(APERTURE, rotation, blades), warp_points(APERTURE, rotation, blades, u=ENDS)])
    angle = (np.arctan2(p[:, 1], p[:, 0]) - rotation + half) % (2 * half) - half
    r = np.hypot(p[:, 0], p[:, 1])
    height = r * np.cos(angle) / np.cos(half)  # 1 on the edge
    assert height.max() < 1 + 1e-5
    assert_even(height**2, 16)
    blade = ((np.arctan2(p[:, 1], p[:, 0]) - rotation + half) % (2 * np.pi) / (2 * half)).astype(int)
    np.testing.assert_allclose(np.bincount(blade % blades), len(p) / blades, rtol=0.03)
    np.testing.assert_allclose(p.mean(0), 0, atol=2e-3)


def test_aperture_without_blades_is_a_disk():
    np.testing.assert_array_equal(warp_points(APERTURE, 0.3, 2), warp_points(DISK))


def test_frames_are_orthonormal():
    """Frames for random normals, and for normals at and near the poles, where the construction changes sign."""

    @wp.kernel(**KERNEL_OPTIONS)
    def frames(
        n: wp.array(dtype=wp.vec3), t: wp.array(dtype=wp.vec3), b: wp.array(dtype=wp.vec3), s: wp.array(dtype=wp.vec3)
    ):
        i = wp.tid()
        t[i] = tangent_of(n[i])
        b[i] = bitangent_of(n[i])
        s[i] = to_world(spherical_direction(0.6, 0.5), t[i], b[i], n[i])

    n = np.random.default_rng(0).normal(size=(2000, 3))
    n[:6] = [(0, 0, 1), (0, 0, -1), (1e-4, 0, -1), (0, -1e-7, -1), (1, 0, 0), (1, 1, -1e-30)]
    n = (n / np.linalg.norm(n, axis=1)[:, None]).astype(np.float32)
    t, b, s = (wp.zeros(len(n), dtype=wp.vec3, device=DEVICE) for _ in range(3))
    launch(load(frames), len(n), [wp.array(n, dtype=wp.vec3, device=DEVICE)], [t, b, s])
    frame = np.stack([t.numpy(), b.numpy(), n], 1).astype(np.float64)
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frame.shape), atol=1e-6)
    assert np.all(np.linalg.det(frame) > 0)
    np.testing.assert_allclose((s.numpy() * n).sum(1), 0.6, atol=1e-6)


# --- pixel filter ---------------------------------------------------------------------------------

SHAPES = {
    "BOX": (lambda x, w: np.ones_like(x), lambda w: 0.5),
    "GAUSSIAN": (lambda x, w: np.exp(-8 * (x / w) ** 2), lambda w: 1.5 * w),
    "BLACKMAN_HARRIS": (
        lambda x, w: sum(
            a * np.cos(k * np.pi * (x / w + 1)) for k, a in enumerate((0.35875, -0.48829, 0.14128, -0.01168))
        ),
        lambda w: w,
    ),
}


@pytest.mark.parametrize("width", [0.01, 1.5, 10.0])
@pytest.mark.parametrize("name", SHAPES)
def test_filter_table_against_direct_integration(name, width):
    shape, extent = SHAPES[name]
    table = filter_table(name, width)
    half = extent(width)
    x = np.linspace(-half, half, 200_001)
    density = shape(x, width)
    cdf = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2)])
    cdf /= cdf[-1]
    assert table.dtype == np.float32 and table.shape == (1024,)
    np.testing.assert_array_equal(table, -table[::-1])
    assert np.all(np.diff(table) > 0) and table[-1] == np.float32(half)
    np.testing.assert_allclose(np.interp(table, x, cdf), np.linspace(0, 1, 1024), atol=2e-6)


@pytest.mark.parametrize("name", SHAPES)
def test_filter_samples_have_the_shape(name):
    shape, extent = SHAPES[name]
    p = warp_points(PIXEL, table=filter_table(name, 1.5))
    half = extent(1.5)
    for axis in (0, 1):
        counts, edges = np.histogram(p[:, axis], 20, (-half, half))
        fine = np.linspace(-half, half, 20_001)
        expected = np.interp(edges, fine, np.concatenate([[0], np.cumsum(shape(fine, 1.5)[1:])]))
        expected = np.diff(expected) / expected[-1]
        np.testing.assert_allclose(counts / len(p), expected, atol=0.005)
    with pytest.raises(ValueError, match="MITCHELL"):
        filter_table("MITCHELL", 1.5)
