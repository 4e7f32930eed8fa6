"""Voronoi and Gabor textures against Cycles, number by number at 1,024 points.

The points are near the origin, on cells' borders, and far away.
"""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.programs.ops.textures.voronoi.cells import CHEBYCHEV, EUCLIDEAN, MANHATTAN, MINKOWSKI
from raybatch_addon.core.programs.ops.textures.voronoi.features import FEATURES
from raybatch_addon.core.programs.ops.textures.voronoi.ops import op_name
from raybatch_addon.export.nodes.collections import Collections
from raybatch_addon.export.nodes.compile import compile_graph
from tests.blender.features.graph import Graph
from tests.blender.features.sheet import TOLERANCE
from tests.core.programs.op_probe import run_op
from tests.support.blender_builders import node_tree
from tests.support.cycles_points import COUNT
from tests.support.running.shares import each_of

# name: coordinates are multiples of 1/4 around 0, or random ones up to this
PLACES = {"cells": None, "near": 10.0, "1e5": 1e5, "1e7": 1e7}
METRICS = {"EUCLIDEAN": EUCLIDEAN, "MANHATTAN": MANHATTAN, "CHEBYCHEV": CHEBYCHEV, "MINKOWSKI": MINKOWSKI}
# a number in this range at each point, also below and above the meaningful ones, but for exponents near 0, where
# nothing is finite
RANGES = {
    "Scale": (-5, 5),
    "Detail": (-0.5, 4.5),
    "Roughness": (-0.1, 1.1),
    "Lacunarity": (0.2, 3),
    "Smoothness": (-0.1, 1.1),
    "Exponent": (0.25, 8),
    "Randomness": (-0.1, 1.1),
}
RNG_SEED = 21


def points_at(place):
    rng = np.random.default_rng(RNG_SEED)
    limit = PLACES[place]
    if limit is None:
        return rng.integers(-12, 12, (COUNT, 4)).astype(np.float32) / 4
    return rng.uniform(-limit, limit, (COUNT, 4)).astype(np.float32)


def drawn(ranges):
    rng = np.random.default_rng(RNG_SEED + 1)
    return {name: rng.uniform(low, high, COUNT).astype(np.float32) for name, (low, high) in ranges.items()}


def assert_same(found, expected, what):
    error = np.abs(found.astype(float) - expected) / np.maximum(1, np.abs(expected))
    assert error.max() <= TOLERANCE, f"{what}: {error.max()} at point {error.max(1).argmax()}"


def inputs_in_use(feature, dimensions, metric):
    names = {"Scale", "Randomness"}
    names |= set() if feature == "n_sphere_radius" else {"Detail", "Roughness", "Lacunarity"}
    names |= {"Smoothness"} if feature == "smooth_f1" else set()
    several = dimensions > 1 and feature not in ("distance_to_edge", "n_sphere_radius")
    return names | ({"Exponent"} if several and metric == "MINKOWSKI" else set()), several


def outputs_in_use(feature, dimensions):
    """Identifiers of the outputs in use, and their indices among the op's outputs."""
    if feature == "n_sphere_radius":
        return {"Radius": 0}
    if feature == "distance_to_edge":
        return {"Distance": 0}
    place = ({"Position": 2} if dimensions > 1 else {}) | ({"W": 3} if dimensions in (1, 4) else {})
    return {"Distance": 0, "Color": 1} | place


def variants():
    for dimensions in (1, 2, 3, 4):
        for feature in FEATURES:
            several = inputs_in_use(feature, dimensions, "")[1]
            for metric in METRICS if several else ["EUCLIDEAN"]:
                for place in PLACES if metric == "EUCLIDEAN" else ("cells", "1e7"):
                    yield dimensions, feature, metric, place


@pytest.mark.parametrize("dimensions, feature, metric, place", each_of(4, variants()))
def test_voronoi(cycles, dimensions, feature, metric, place):
    used, _ = inputs_in_use(feature, dimensions, metric)
    points, numbers = points_at(place), drawn(RANGES)
    inputs = {name: numbers[name] for name in used}
    inputs |= ({} if dimensions == 1 else {"Vector": points[:, :3]}) | (
        {"W": points[:, 3]} if dimensions in (1, 4) else {}
    )
    operands = [points[:, :3], points[:, 3], *(numbers[name] if name in used else 0.0 for name in RANGES)]
    among = [op_name(dimensions, each) for each in FEATURES]
    for normalize in (False, True):
        found = run_op(op_name(dimensions, feature), [METRICS[metric], normalize], operands, among=among)
        for name, index in outputs_in_use(feature, dimensions).items():
            expected = cycles.values(
                "ShaderNodeTexVoronoi",
                inputs,
                name,
                voronoi_dimensions=f"{dimensions}D",
                feature=feature.upper(),
                distance=metric,
                normalize=normalize,
            )
            values = found[index] if found[index].ndim == 2 else np.repeat(found[index][:, None], 3, 1)
            assert_same(values, expected, f"{name}, normalize {normalize}")


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", ["2D", "3D"])
def test_gabor(cycles, kind, place):
    points = points_at(place)[:, :3]
    numbers = drawn({"Scale": (-3, 3), "Frequency": (-0.5, 8), "Anisotropy": (-0.1, 1.1)})
    directions = np.random.default_rng(RNG_SEED + 2).normal(size=(COUNT, 3)).astype(np.float32)
    turn = drawn({"Orientation 2D": (-7, 7)})["Orientation 2D"]
    orientation = {"Orientation 2D": turn} if kind == "2D" else {"Orientation 3D": directions}
    found = run_op(f"gabor_{kind.lower()}", [], [points, *numbers.values(), *orientation.values()])
    for name, values in zip(("Value", "Phase", "Intensity"), found):
        expected = cycles.values(
            "ShaderNodeTexGabor", {"Vector": points} | numbers | orientation, name, gabor_type=kind
        )
        values = np.repeat(values[:, None], 3, 1)
        if name == "Phase":  # 0 and 1 are the same phase
            values = expected + (values - expected + 0.5) % 1.0 - 0.5
        assert_same(values, expected, name)


# --- graphs


def ops_of(kind, output, inputs=None, **properties):
    """Names of the ops of a graph that emits an output of a node.

    `inputs(graph)` gives the node's inputs.
    """
    material = bpy.data.materials.new("Ops")
    tree, surface = node_tree(material)
    graph = Graph(tree)
    node = graph.node(kind, None, **properties)
    graph.fill(node, inputs(graph) if inputs else {})
    graph.set(surface, graph.value("ShaderNodeEmission", {"Color": graph.outputs(node)[output]}))
    compiled = compile_graph(surface, material, Collections())
    assert not compiled.notes
    return {step.op for step in compiled.program.instructions}


@pytest.mark.parametrize("feature", FEATURES)
@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
def test_each_feature_and_number_of_dimensions_has_its_op(addon, dimensions, feature):
    output = next(iter(outputs_in_use(feature, dimensions)))
    # Blender would make a constant of a constant
    varying = (lambda graph: {"W": graph.x}) if dimensions == 1 else None
    ops = ops_of("ShaderNodeTexVoronoi", output, varying, voronoi_dimensions=f"{dimensions}D", feature=feature.upper())
    assert {name for name in ops if name.startswith("voronoi")} == {op_name(dimensions, feature)}
    assert ("generated" in ops) == (dimensions > 1)


@pytest.mark.parametrize("kind", ["2D", "3D"])
def test_gabor_in_a_graph(addon, kind):
    ops = ops_of("ShaderNodeTexGabor", "Value", gabor_type=kind)
    assert {"generated", f"gabor_{kind.lower()}"} <= ops
