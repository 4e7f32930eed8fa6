"""White noise, waves, magic, gradients, checkers and bricks at known points, and at the ends of numbers."""

import math

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.op import op_named
from raybatch_addon.core.programs.ops.textures.gradient import GradientKind
from raybatch_addon.core.programs.ops.textures.magic import MAGIC_DEPTH_MAX
from raybatch_addon.core.programs.ops.textures.wave import WaveKind, WaveProfile
from tests.core.programs.op_probe import run_op
from tests.twins.hash_reference import jenkins

AWKWARD = [0.0, -0.0, 1e-40, 1.0, -1.0, 1e7, -1e7, 1e12, 1e30, -1e38, 3.4e38, math.inf, -math.inf, math.nan]
TAU = 2 * math.pi
COLORS = ((0.8, 0.3, 0.1), (0.1, 0.4, 0.9), (0.2, 0.2, 0.2))


def points_within(limit, count, seed=1):
    return np.random.default_rng(seed).uniform(-limit, limit, (count, 3)).astype(np.float32)


# --- white noise


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
def test_white_noise_is_lookup3_of_the_bits_and_even(dimensions):
    vectors, numbers = points_within(1e3, 20_000), points_within(1e3, 20_000, seed=2)[:, 0]
    values, colors = run_op("white_noise", [dimensions], [vectors, numbers])
    alone, nothing = run_op("white_noise", [dimensions], [vectors, numbers], skip="V")
    assert np.array_equal(values, alone) and np.array_equal(values, colors[:, 0]) and not nothing.any()
    words = {1: numbers[:, None], 2: vectors[:, :2], 3: vectors, 4: np.concatenate([vectors, numbers[:, None]], 1)}[
        dimensions
    ]
    for row, value in zip(np.ascontiguousarray(words[:50]).view(np.uint32), values):
        assert value == np.float32(jenkins([int(word) for word in row])) * np.float32(2.0**-32)
    for channel in colors.T:
        counts = np.histogram(channel, 20, (0, 1))[0]
        assert ((counts - 1000) ** 2 / 1000).sum() < 60
    assert np.abs(np.corrcoef(colors.T) - np.eye(3)).max() < 0.03


# --- waves


def wave(kind, profile, points, skip="", **more):
    values = {"scale": 1.0, "phase": 0.0, "amount": 0.0, "detail": 2.0, "detail_scale": 1.0, "roughness": 0.5} | more
    return run_op("wave", [kind, profile], [points, *values.values()], skip)[0]


def profile_of(profile, angle):
    turns = angle / TAU
    if profile == WaveProfile.SINE:
        return 0.5 - 0.5 * np.cos(angle)
    return turns - np.floor(turns) if profile == WaveProfile.SAW else np.abs(turns - np.floor(turns + 0.5)) * 2


@pytest.mark.parametrize("profile", list(WaveProfile))
@pytest.mark.parametrize("kind", list(WaveKind))
def test_waves_have_their_fronts_and_profiles(kind, profile):
    points = points_within(0.4, 300).astype(float)
    angles = {
        WaveKind.BANDS_X: 20 * points[:, 0],
        WaveKind.BANDS_Y: 20 * points[:, 1],
        WaveKind.BANDS_Z: 20 * points[:, 2],
        WaveKind.BANDS_DIAGONAL: 10 * points.sum(1),
        WaveKind.RINGS_X: 20 * np.linalg.norm(points[:, 1:], axis=1),
        WaveKind.RINGS_Y: 20 * np.linalg.norm(points[:, ::2], axis=1),
        WaveKind.RINGS_Z: 20 * np.linalg.norm(points[:, :2], axis=1),
        WaveKind.RINGS_SPHERICAL: 20 * np.linalg.norm(points, axis=1),
    }
    found = wave(kind, profile, points, phase=0.7)
    difference = np.abs(found - profile_of(profile, angles[kind] + 0.7))
    assert np.minimum(difference, 1 - difference if profile == WaveProfile.SAW else 1).max() < 1e-4
    assert found.min() >= 0 and found.max() <= 1


def test_distortion_moves_a_wave_by_at_most_its_amount():
    points = points_within(3, 2000)
    still, moved = (wave(WaveKind.BANDS_X, WaveProfile.SAW, points, amount=amount) for amount in (0.0, 0.8))
    difference = np.abs(moved.astype(float) - still)
    turned = np.minimum(difference, 1 - difference) * TAU
    assert turned.mean() > 0.1 and turned.max() < 0.81


# --- magic


def magic_reference(p, depth, d):
    x, y, z = (
        np.sin(p.sum(1) * 5),
        np.cos((-p[:, 0] + p[:, 1] - p[:, 2]) * 5),
        -np.cos((-p[:, 0] - p[:, 1] + p[:, 2]) * 5),
    )
    if depth > 0:
        x, y, z = x * d, y * d, z * d
    steps = [
        lambda x, y, z: (x, -np.cos(x - y + z) * d, z),
        lambda x, y, z: (np.cos(x - y - z) * d, y, z),
        lambda x, y, z: (x, y, np.sin(-x - y - z) * d),
        lambda x, y, z: (-np.cos(-x + y - z) * d, y, z),
        lambda x, y, z: (x, -np.sin(-x + y + z) * d, z),
        lambda x, y, z: (x, -np.cos(-x + y + z) * d, z),
        lambda x, y, z: (np.cos(x + y + z) * d, y, z),
        lambda x, y, z: (x, y, np.sin(x + y - z) * d),
        lambda x, y, z: (-np.cos(-x - y + z) * d, y, z),
        lambda x, y, z: (x, -np.sin(x - y + z) * d, z),
    ]
    for step in steps[:depth]:
        x, y, z = step(x, y, z)
    return 0.5 - np.stack([x, y, z], 1) / (2 * d if d else 1)


@pytest.mark.parametrize("distortion", [1.0, 0.0, -1.7])
@pytest.mark.parametrize("depth", range(MAGIC_DEPTH_MAX + 1))
def test_magic_is_a_chain_of_sines(depth, distortion):
    points = points_within(1, 200)
    values, colors = run_op("magic", [depth], [points, 1.0, distortion])
    assert np.allclose(colors, magic_reference(points.astype(float), depth, distortion), rtol=0, atol=2e-4)
    assert np.allclose(values, colors.mean(1), atol=1e-6)


def test_magic_repeats_with_a_turn():
    points = points_within(1, 100).astype(float)
    near, far = (run_op("magic", [3], [points + TAU * k, 1.0, 1.0])[1] for k in (0, 3))
    assert np.abs(near - far).max() < 1e-3


# --- gradients

G = GradientKind
KNOWN = [
    (G.LINEAR, (0.3, 9, 9), 0.3),
    (G.LINEAR, (-1, 0, 0), 0.0),
    (G.LINEAR, (math.inf, 0, 0), 1.0),
    (G.QUADRATIC, (0.5, 0, 0), 0.25),
    (G.QUADRATIC, (-0.5, 0, 0), 0.0),
    (G.EASING, (0.5, 0, 0), 0.5),
    (G.EASING, (0.25, 0, 0), 0.15625),
    (G.EASING, (2, 0, 0), 1.0),
    (G.DIAGONAL, (0.2, 0.4, 9), 0.3),
    (G.RADIAL, (1, 0, 0), 0.5),
    (G.RADIAL, (0, 1, 0), 0.75),
    (G.RADIAL, (0, -1, 0), 0.25),
    (G.RADIAL, (-1, 0, 0), 1.0),
    (G.RADIAL, (0, 0, 1), 0.5),
    (G.SPHERICAL, (0, 0, 0), 0.999999),
    (G.SPHERICAL, (0, 0.5, 0), 0.5),
    (G.SPHERICAL, (0, 0, 1), 0.0),
    (G.QUADRATIC_SPHERE, (0, 0.5, 0), 0.25),
    (G.QUADRATIC_SPHERE, (3, 4, 0), 0.0),
]


@pytest.mark.parametrize("kind, point, expected", KNOWN)
def test_gradients_at_known_points(kind, point, expected):
    value, color = run_op("gradient", [kind], [point])
    assert value[0] == pytest.approx(expected, abs=2e-6)
    assert (color == value[0]).all()


# --- checkers


def test_checker_cubes_alternate():
    cells = np.random.default_rng(3).integers(-40, 40, (500, 3))
    value, color = run_op("checker", [], [(cells + 0.5) / 2, *COLORS[:2], 2.0])
    odd = cells.sum(1) % 2
    assert np.array_equal(value, odd)
    assert np.array_equal(color, np.where(odd[:, None] == 1, COLORS[0], COLORS[1]).astype(np.float32))


def test_both_faces_of_a_unit_cube_belong_to_its_cell():
    corners = [(0, 0.5, 0.5), (1, 0.5, 0.5), (1.00001, 0.5, 0.5), (-1e-5, 0.5, 0.5)]
    assert np.array_equal(run_op("checker", [], [corners, *COLORS[:2], 1.0])[0], [0, 0, 1, 1])


# --- bricks


def brick(points, offset=0.5, offset_frequency=2, squash=1.0, squash_frequency=2, **more):
    values = {"scale": 1.0, "size": 0.1, "smooth": 0.0, "bias": 0.0, "width": 1.0, "height": 0.5} | more
    return run_op("brick", [offset_frequency, squash_frequency], [points, *COLORS, *values.values(), offset, squash])


def test_mortar_is_where_edges_are():
    points = points_within(20, 4000)
    row = np.floor(points[:, 1] / 0.5)
    x = points[:, 0] + np.where(row % 2 == 0, 0.5, 0.0)
    edge = np.minimum.reduce([x % 1, 1 - x % 1, points[:, 1] % 0.5, 0.5 - points[:, 1] % 0.5])
    sure = np.abs(edge - 0.1) > 1e-4
    mortar, color = brick(points)
    assert np.array_equal(mortar[sure], (edge < 0.1)[sure])
    assert np.allclose(color[mortar == 1], COLORS[2])
    # one tint a brick, mixed of two colours
    tints = (color[:, 0] - COLORS[0][0]) / (COLORS[1][0] - COLORS[0][0])
    inside = mortar == 0
    bricks = row * 1000 + np.floor(x)
    for number in np.unique(bricks[inside])[:20]:
        assert np.ptp(tints[inside & (bricks == number)]) < 1e-5
    assert tints[inside].min() >= -1e-5 and tints[inside].max() <= 1 + 1e-5 and tints[inside].std() > 0.2


def test_smooth_mortar_fades_in_from_the_inside():
    x = np.linspace(0, 0.5, 200)
    points = np.stack([x, np.full(200, 0.75), np.zeros(200)], 1)
    mortar = brick(points, offset=0.0, smooth=0.5)[0]
    t = np.clip((1 - x / 0.1) / 0.5, 0, 1)
    assert np.allclose(mortar, 3 * t**2 - 2 * t**3, atol=1e-5)


def test_squash_makes_bricks_of_some_rows_wider_and_bias_moves_tints():
    rows = np.array([[0.55, 0.25, 0], [0.55, 0.75, 0]])
    assert np.array_equal(brick(rows, offset=0.0, squash=0.5, size=0.1)[0], [1, 0])
    points = points_within(20, 500)
    for bias, color in ((-1.0, COLORS[0]), (1.0, COLORS[1])):
        mortar, colors = brick(points, bias=bias)
        assert np.allclose(colors[mortar == 0], color, atol=1e-6)


# --- all of them

OPERANDS = {  # immediates; letters of operands: v coordinates, c a colour, n a number
    "white_noise": ([3], "vn"),
    "wave": ([5, 1], "vnnnnnn"),
    "magic": ([7], "vnn"),
    "checker": ([], "vccn"),
    "brick": ([2, 3], "vcccnnnnnnnn"),
    "gradient": ([4], "v"),
    "affine": ([1], "vcccc"),
}


@pytest.mark.parametrize("name", sorted(OPERANDS))
def test_any_coordinates_and_numbers_give_finite_results(name):
    immediates, letters = OPERANDS[name]
    rng = np.random.default_rng(5)
    for wild in (False, True):
        operands = [
            rng.choice(AWKWARD, (3000, 3))
            if letter == "v"
            else COLORS[0]
            if letter == "c"
            else rng.choice(AWKWARD, 3000)
            if wild
            else 0.5
            for letter in letters
        ]
        for found in run_op(name, immediates, operands):
            assert np.isfinite(found).all()


@pytest.mark.parametrize(
    "name, immediates, operands",
    [
        ("gradient", (4,), [(0.3, -0.7, 0.1)]),
        ("gradient", (5,), [(0.3, -0.2, 0.1)]),
        ("magic", (6,), [(0.3, -70.5, 5.0), 3.0, 1.2]),
        ("checker", (), [(-0.3, 1.7, 1.1), *COLORS[:2], 5.0]),
        ("affine", (0,), [(1.0, 2.0, 3.0), *COLORS, (0.5, 0.0, -1.0)]),
        ("affine", (1,), [(1.0, 2.0, 3.0), *COLORS, (0.5, 0.0, -1.0)]),
    ],
)
def test_constants_fold_to_what_a_device_gives(name, immediates, operands):
    assert op_named(name).foldable
    folded = ProgramBuilder().value(name, *immediates, *operands)
    for value, found in zip(
        folded if isinstance(folded, tuple) else (folded,), run_op(name, immediates, operands), strict=True
    ):
        assert np.allclose(value.constant, found[0], rtol=0, atol=1e-5)
