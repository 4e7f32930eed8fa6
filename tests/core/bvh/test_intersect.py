"""The triangle test: its twin in NumPy, its error bound, and that nothing slips between two triangles."""

import functools
from fractions import Fraction

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.intersect import EDGE_TINY
from raybatch_addon.core.bvh.margin import SLAB_MARGIN
from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.native.build import native_source
from tests.support.under_test import BLOCK_DIM
from tests.twins.watertight import fused_multiply_add, intersect_exact, intersect_float32

U = 2.0**-24
BOUND = 19  # u times (|origin| + |vertex|), see margin.py


def round_to_float32(x: Fraction) -> np.float32:
    """The nearest float32, the even one of two."""
    guess = np.float32(float(x))
    candidates = [np.nextafter(guess, np.float32(-np.inf)), guess, np.nextafter(guess, np.float32(np.inf))]
    return min(candidates, key=lambda c: (abs(Fraction(float(c)) - x), int(np.array(c).view(np.int32)) & 1))


def test_the_emulated_fma_rounds_once():
    rng = np.random.default_rng(0)
    a, b = (rng.integers(1, 1 << 24, 3000) * rng.choice([-1.0, 1.0], 3000) for _ in "ab")
    # sums near a tie, of all relative sizes, with cancellation, and with results that are not normal
    c = -np.float32(a * b) * np.float32(2.0) ** rng.integers(-40, 40, 3000)
    c[:1000] = -np.float32((a * b)[:1000])
    scale = np.float32(2.0) ** np.repeat([0, -74, 30], 1000)
    with np.errstate(over="ignore"):
        a, b, c = (x.astype(np.float32) for x in (a * scale, b * scale, c * scale.astype(np.float64) ** 2))
    result = fused_multiply_add(a, b, c)
    for x, y, z, r in zip(a, b, c, result):
        if np.isfinite(r):
            assert r == round_to_float32(Fraction(float(x)) * Fraction(float(y)) + Fraction(float(z)))


@functools.cache
def meet_kernel() -> wp.Kernel:
    @wp.func_native(
        native_source("traverse/triangle.h", EDGE_TINY=EDGE_TINY)
        + """
        const auto& o = origin.data[i];
        const auto& d = direction.data[i];
        const auto* a = corners.data + 3 * i;
        auto corner = [](const wp::vec_t<3, float>& p) -> Corner { return {p[0], p[1], p[2]}; };
        const ShearedRay ray = shear_ray(o[0], o[1], o[2], d[0], d[1], d[2]);
        float t = 0.0f, v = 0.0f, w = 0.0f;
        const bool hit = meet_triangle(ray, corner(a[0]), corner(a[1]), corner(a[2]), t, v, w);
        out.data[i] = wp::vec_t<4, float>(hit ? 1.0f : 0.0f, t, v, w);
        """
    )
    def meet(
        origin: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        corners: wp.array(dtype=wp.vec3),
        i: int,
        out: wp.array(dtype=wp.vec4),
    ): ...

    @wp.kernel(**KERNEL_OPTIONS)
    def kernel(
        origin: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        corners: wp.array(dtype=wp.vec3),
        out: wp.array(dtype=wp.vec4),
    ):
        meet(origin, direction, corners, wp.tid(), out)

    return kernel


def cases(name: str, count: int = 4000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins, directions and triangles [n, 3, 3]."""
    rng = np.random.default_rng(len(name))
    corners = rng.uniform(-1, 1, (count, 3, 3))
    offset, scale = 0.0, 1.0
    if name == "slivers":
        corners[:, 2] = (corners[:, 0] + corners[:, 1]) / 2 + 1e-6 * rng.normal(size=(count, 3))
    elif name == "far":
        offset = np.array([1e5, -3e4, 2e3])
    elif name == "tiny":
        scale = 1e-18
    elif name == "huge":
        scale = 5e17
    elif name == "grid":
        corners = rng.integers(-2, 3, (count, 3, 3)).astype(np.float64)
    weights = rng.dirichlet((1, 1, 1), count)
    weights[: count // 4] = np.eye(3)[rng.integers(3, size=count // 4)]
    weights[count // 4 : count // 2, 1] = 0.0
    weights /= weights.sum(1, keepdims=True)
    target = np.einsum("nc,nck->nk", weights, corners)
    origin = rng.uniform(-2, 2, (count, 3)) if name != "grid" else rng.integers(-3, 4, (count, 3)).astype(np.float64)
    origin[-count // 5 :] = target[-count // 5 :] + 1e-6 * rng.normal(size=(count // 5, 3))
    origin, corners, target = (
        (origin * scale + offset).astype(np.float32),
        (corners * scale + offset).astype(np.float32),
        target * scale + offset,
    )
    direction = target - origin
    axis = slice(0, count, 7)
    direction[axis] = np.eye(3)[rng.integers(3, size=len(direction[axis]))] * rng.choice(
        [-1, 1], (len(direction[axis]), 1)
    )
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    direction = np.where(length > 0, direction / np.where(length > 0, length, 1), (1, 0, 0)) * rng.choice(
        [1, 1, 1e-3, 50], (count, 1)
    )
    return origin, direction.astype(np.float32), corners


CASES = ("plain", "slivers", "far", "tiny", "huge", "grid")


@pytest.mark.parametrize("name", CASES)
def test_the_native_text_equals_its_twin(name, device):
    origin, direction, corners = cases(name)
    out = wp.zeros(len(origin), dtype=wp.vec4, device=device)
    inputs = [wp.array(x.reshape(-1, 3), dtype=wp.vec3, device=device) for x in (origin, direction, corners)]
    wp.launch(meet_kernel(), len(origin), [*inputs, out], device=device, block_dim=BLOCK_DIM)
    native = out.numpy()
    hit, t, v, w = intersect_float32(origin, direction, corners[:, 0], corners[:, 1], corners[:, 2])
    assert hit.any() and not hit.all()
    if device == "cpu":
        assert np.array_equal(native[:, 0] != 0, hit)
        assert np.array_equal(native[hit][:, 1:], np.stack([t, v, w], 1)[hit])
        return
    # on CUDA but for rounding, which may also decide on which side of 0 a t is
    error = 32 * U * (np.abs(origin).max(1) + np.abs(corners).max((1, 2))) / np.abs(direction).max(1)
    assert np.array_equal((native[:, 0] != 0)[~(np.abs(t) <= error)], hit[~(np.abs(t) <= error)])
    both = hit & (native[:, 0] != 0)
    assert (np.abs(native[:, 1] - t)[both] <= error[both]).all()
    assert np.allclose(native[both][:, 2:], np.stack([v, w], 1)[both], rtol=0, atol=32 * U)


@pytest.mark.parametrize("name", CASES)
def test_hits_lie_within_the_bound(name):
    """The exact ray's point at the computed distance is within the box of the triangle, grown by the bound."""
    origin, direction, corners = cases(name)
    hit, t, v, w = intersect_float32(origin, direction, corners[:, 0], corners[:, 1], corners[:, 2])
    centre = corners.reshape(-1, 3).mean(0).astype(np.float32).astype(np.float64)
    o, p = origin[hit] - centre, corners[hit] - centre
    point = o + t[hit, None].astype(np.float64) * direction[hit]  # in float64: 2**-29 of the bound
    outside = np.maximum(p.min(1) - point, point - p.max(1)).max(1)
    reach = np.abs(o).max(1) + np.abs(p).max((1, 2))
    assert (outside <= BOUND * U * reach).all()
    assert SLAB_MARGIN >= (BOUND + 5) * U
    assert ((v[hit] >= 0) & (w[hit] >= 0) & (v[hit] + w[hit] <= 1 + 8 * U)).all()


@pytest.mark.parametrize("name", ["plain", "far", "grid"])
def test_hits_are_true_but_for_the_bound(name):
    """Compared with exact arithmetic: what is clearly inside is hit, what is clearly outside is not, and t is right."""
    origin, direction, corners = cases(name, 400)
    hit, t, *_ = intersect_float32(origin, direction, corners[:, 0], corners[:, 1], corners[:, 2])
    clear = 0
    for i in range(len(origin)):
        exact = intersect_exact(origin[i], direction[i], *corners[i])
        if exact is None:
            continue
        distance, weights = exact
        reach = float(np.abs(origin[i] - corners[i]).max())
        edges = corners[i] - np.roll(corners[i], 1, axis=0)
        normal = np.cross(edges[0].astype(np.float64), edges[1])
        d = direction[i].astype(np.float64)
        steep = abs(normal @ d) / max(np.linalg.norm(normal) * np.linalg.norm(d), 1e-300)
        height = np.linalg.norm(normal) / max(np.linalg.norm(edges, axis=1).max(), 1e-300)
        slack = 64 * U * reach / max(steep * height, 1e-300)
        if slack > 0.01:
            continue  # seen edge-on, or a sliver
        clear += 1
        if min(weights) > slack and float(distance) > 64 * U * reach / np.linalg.norm(d) / steep:
            assert hit[i]
            assert abs(float(distance) - float(t[i])) * np.linalg.norm(d) <= 64 * U * reach / steep
        if min(weights) < -slack:
            assert not hit[i]
    assert clear > 100


@pytest.mark.parametrize("scale", [1e-18, 1.0, 5e17])
def test_nothing_slips_between_two_triangles(scale):
    """Rays at the shared edge of two triangles that cover a strip around it meet at least one of them."""
    rng = np.random.default_rng(7)
    count = 20000
    edge = rng.uniform(-1, 1, (count, 2, 3))
    aside = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-4, 0, (count, 1))
    quad = np.stack(
        [edge[:, 0], edge[:, 1], (edge[:, 0] + edge[:, 1]) / 2 + aside, (edge[:, 0] + edge[:, 1]) / 2 - aside], 1
    )
    share = rng.uniform(0.3, 0.7, (count, 1))
    quad = (quad * scale).astype(np.float32)
    target = quad[:, 0] * share + quad[:, 1] * (1 - share)
    origin = (target + 2 * scale * rng.normal(size=(count, 3))).astype(np.float32)
    direction = (target - origin) / scale
    # across the quad, not along it
    normal = np.cross(quad[:, 1].astype(np.float64) - quad[:, 0], aside)
    cosine = np.abs((normal * direction).sum(1)) / (np.linalg.norm(normal, axis=1) * np.linalg.norm(direction, axis=1))
    width = np.linalg.norm(aside, axis=1)
    wanted = cosine * width > 1e-4
    direction = direction.astype(np.float32)
    one = intersect_float32(origin, direction, quad[:, 0], quad[:, 1], quad[:, 2])[0]
    other = intersect_float32(origin, direction, quad[:, 1], quad[:, 0], quad[:, 3])[0]
    assert wanted.sum() > count / 2
    assert (one | other)[wanted].all()


def test_tiny_edge_functions_are_computed_again():
    # products of 2**-75 squared are below float32; the ray passes the triangle in the middle
    size = 2.0**-75
    corners = (np.array([[-1, -1, 1], [1, -1, 1], [0, 2, 1]]) * size).astype(np.float32)
    hit, t, v, w = intersect_float32(np.zeros(3), np.array([0, 0, 1]), *corners)
    assert (2 * size) ** 2 < EDGE_TINY and hit[0] and t[0] == np.float32(size)
    assert v[0] == np.float32(1 / 3) and w[0] == np.float32(1 / 3)


def test_triangles_without_area_are_never_met():
    point = np.array([0.1, 0.2, 0.5], np.float32)
    for corners in ((point, point, point), (point, point, point + 1), (np.zeros(3), np.zeros(3), np.zeros(3))):
        assert not intersect_float32(np.zeros(3), point, *corners)[0][0]
