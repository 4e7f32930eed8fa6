"""Voronoi textures against plain searches in float64, and at the ends of the range of numbers."""

import functools
import itertools

import numpy as np
import pytest

from raybatch_addon.core.programs.ops.textures.voronoi.cells import CHEBYCHEV, EUCLIDEAN, MANHATTAN, MINKOWSKI
from raybatch_addon.core.programs.ops.textures.voronoi.features import FEATURES
from raybatch_addon.core.programs.ops.textures.voronoi.ops import op_name
from tests.core.programs.op_probe import run_op
from tests.twins.hash_reference import jenkins, pcg

DIMENSIONS = (1, 2, 3, 4)
DEFAULTS = {  # in the order of the op's words
    "metric": EUCLIDEAN,
    "normalize": 0,
    "scale": 1.0,
    "detail": 0.0,
    "roughness": 0.5,
    "lacunarity": 2.0,
    "smoothness": 1.0,
    "exponent": 0.5,
    "randomness": 1.0,
}


SAMPLE = np.dtype([("distance", np.float32), ("color", np.float32, 3), ("position", np.float32, 4)])


def evaluate(dimensions, feature, points, **values):
    """Samples at `points` [n, 4], by the op, as one structured array; edges and radii are distances alone."""
    settings = {**DEFAULTS, **values}
    metric, normalize = settings.pop("metric"), settings.pop("normalize")
    points = np.asarray(points, np.float32)
    among = [op_name(dimensions, each) for each in FEATURES]
    operands = [points[:, :3], points[:, 3], *settings.values()]
    found = run_op(op_name(dimensions, feature), [metric, normalize], operands, among=among)
    out = np.zeros(len(points), SAMPLE)
    out["distance"] = found[0]
    if len(found) > 1:
        out["color"], out["position"][:, :3], out["position"][:, 3] = found[1:]
    return out


def grid_points(count, seed=3):
    """Points on a grid that float32 holds, [count, 4]."""
    return np.random.default_rng(seed).integers(-4096, 4096, (count, 4)) / 1024.0


def coordinates(dimensions, grid_point):
    return grid_point[3:] if dimensions == 1 else grid_point[:dimensions]


@functools.cache
def random_point(cell):
    if len(cell) == 1:
        return np.array([jenkins([int(np.float32(cell[0]).view(np.uint32))]) / 2**32])
    return np.array(pcg(cell))


def points_around(dimensions, grid_point):
    """Random points of the cell of `grid_point` and its neighbours, [3**dimensions, dimensions], and the cells."""
    cell = np.floor(coordinates(dimensions, grid_point)).astype(int)
    cells = [
        tuple(int(x) for x in cell + np.array(step[::-1])) for step in itertools.product((-1, 0, 1), repeat=dimensions)
    ]
    return np.array([np.array(c) + random_point(c) for c in cells]), cells


def measure(difference, metric, exponent):
    difference = np.abs(difference)
    if metric == EUCLIDEAN:
        return np.sqrt((difference**2).sum(-1))
    if metric == MANHATTAN:
        return difference.sum(-1)
    if metric == CHEBYCHEV:
        return difference.max(-1)
    return (difference**exponent).sum(-1) ** (1 / exponent)


@pytest.mark.parametrize("metric", [EUCLIDEAN, MANHATTAN, CHEBYCHEV, MINKOWSKI])
@pytest.mark.parametrize("dimensions", DIMENSIONS)
def test_nearest_and_second_nearest_point(dimensions, metric):
    chosen = grid_points(40)
    nearest = evaluate(dimensions, "f1", chosen, metric=metric)
    second = evaluate(dimensions, "f2", chosen, metric=metric)
    for i, grid_point in enumerate(chosen):
        points, cells = points_around(dimensions, grid_point)
        distances = measure(points - coordinates(dimensions, grid_point), EUCLIDEAN if dimensions == 1 else metric, 0.5)
        order = np.argsort(distances, kind="stable")
        for found, index in ((nearest, order[0]), (second, order[1])):
            assert found["distance"][i] == pytest.approx(distances[index], abs=2e-5)
            assert coordinates(dimensions, found["position"][i]) == pytest.approx(points[index], abs=2e-6)
            if dimensions > 2:
                assert found["color"][i] == pytest.approx(random_point(cells[index])[:3], abs=1e-6)


@pytest.mark.parametrize("dimensions", DIMENSIONS)
def test_edges_and_radii(dimensions):
    chosen = grid_points(40)
    edge = evaluate(dimensions, "distance_to_edge", chosen)["distance"]
    radius = evaluate(dimensions, "n_sphere_radius", chosen)["distance"]
    for i, grid_point in enumerate(chosen):
        points, cells = points_around(dimensions, grid_point)
        to_points = points - coordinates(dimensions, grid_point)
        distances = measure(to_points, EUCLIDEAN, 0)
        first = int(np.argmin(distances))
        others = np.delete(to_points, first, axis=0)
        if dimensions == 1:
            expected = np.abs(to_points[[0, 2]] + to_points[1]).min() / 2
        else:
            across = others - to_points[first]
            expected = ((others + to_points[first]) / 2 * across).sum(1) / measure(across, EUCLIDEAN, 0)
        assert edge[i] == pytest.approx(np.min(expected), abs=2e-5)
        centre = np.zeros(4)
        centre[slice(3, 4) if dimensions == 1 else slice(0, dimensions)] = np.array(cells[first]) + 0.5
        neighbours, _ = points_around(dimensions, centre)
        gaps = np.sort(measure(neighbours - points[first], EUCLIDEAN, 0))
        assert radius[i] == pytest.approx(gaps[1] / 2, abs=2e-6)


@pytest.mark.parametrize("dimensions", DIMENSIONS)
def test_no_smoothness_is_the_nearest_point(dimensions):
    chosen = grid_points(200)
    exact = evaluate(dimensions, "f1", chosen)
    for smoothness in (0.0, 1e-4):
        smooth = evaluate(dimensions, "smooth_f1", chosen, smoothness=smoothness)
        assert np.abs(smooth["distance"] - exact["distance"]).max() < 1e-3
    assert (evaluate(dimensions, "smooth_f1", chosen)["distance"] <= exact["distance"] + 1e-6).all()


@pytest.mark.parametrize("dimensions", DIMENSIONS)
def test_octaves_add_up(dimensions):
    chosen = grid_points(200)
    single = [evaluate(dimensions, "f1", chosen, scale=2.0**k)["distance"] for k in range(3)]
    fractal = evaluate(dimensions, "f1", chosen, detail=1.25)["distance"]
    assert fractal == pytest.approx(single[0] + 0.5 * single[1] + 0.25 * 0.25 * single[2], abs=1e-5)
    normalized = evaluate(dimensions, "f1", chosen, detail=1.25, normalize=1)["distance"]
    farthest = 1.0 if dimensions == 1 else dimensions**0.5
    assert normalized == pytest.approx(fractal / ((1 + 0.5 + 0.25 * 0.25) * farthest), abs=1e-5)


@pytest.mark.parametrize("feature", FEATURES)
@pytest.mark.parametrize("dimensions", DIMENSIONS)
def test_any_input_gives_finite_numbers(dimensions, feature):
    extremes = [0.0, -0.0, 1e7, -1e7, 2.0**31, 1e20, -1e38, np.inf, -np.inf, np.nan]
    rng = np.random.default_rng(4)
    chosen = rng.choice(extremes, (40, 4))
    settings = [
        {},
        {"detail": 15.0},
        {"scale": np.inf},
        {"scale": 0.0, "detail": np.nan},
        {"lacunarity": 0.0, "detail": 2.5, "normalize": 1},
        {"lacunarity": 1e30, "detail": 3.0},
        {"metric": MINKOWSKI, "exponent": 0.0, "normalize": 1},
        {"metric": MINKOWSKI, "exponent": np.nan},
        {"metric": MINKOWSKI, "exponent": -100.0},
        {"randomness": np.nan, "smoothness": np.nan, "roughness": np.inf},
    ]
    for values in settings:
        result = evaluate(dimensions, feature, chosen[:4] if values.get("detail") == 15.0 else chosen, **values)
        for name in result.dtype.names:
            assert np.isfinite(result[name]).all(), (values, name)


def test_far_places_have_cells_of_their_own():
    far = np.full((2, 4), 1e7)
    far[1] += 8.0
    distances = evaluate(3, "f1", far)["distance"]
    assert distances[0] != distances[1]
    assert op_name(3, "f1") == "voronoi_3d_f1"
