"""Procedural textures against Cycles, number by number at 1,024 points: near, on cells' borders, and far away."""

import functools
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.core.programs.ops.textures.gradient import GradientKind
from raybatch_addon.core.programs.ops.textures.noise import FractalKind
from raybatch_addon.core.programs.ops.textures.wave import WaveKind, WaveProfile
from raybatch_addon.export.nodes.collections import Collections
from raybatch_addon.export.nodes.compile import compile_graph
from raybatch_addon.export.nodes.textures.mapping import affine_of
from tests.blender.features.graph import Graph
from tests.blender.features.sheet import TOLERANCE
from tests.core.programs.op_probe import run_op
from tests.support.blender_builders import node_tree
from tests.support.cycles_points import COUNT

# name: coordinates are multiples of 1/4 around 0, or random ones up to this
PLACES = {"cells": None, "near": 10.0, "1e5": 1e5, "1e7": 1e7}
PROFILES = {WaveProfile.SINE: "SIN", WaveProfile.SAW: "SAW", WaveProfile.TRIANGLE: "TRI"}
RNG_SEED = 20


def inputs_at(place, **ranges):
    """Vector and W, and other inputs drawn from their ranges."""
    rng = np.random.default_rng(RNG_SEED)
    limit = PLACES[place]
    draw = functools.partial(rng.integers, -12, 12) if limit is None else functools.partial(rng.uniform, -limit, limit)
    points = np.asarray(draw((COUNT, 4)), np.float32)
    points = points / 4 if limit is None else points
    more = {
        name: rng.uniform(low, high, (COUNT, 3) if width else COUNT).astype(np.float32)
        for name, (low, high, *width) in ranges.items()
    }
    return points[:, :3], points[:, 3], more


def assert_same(cycles, kind, op, immediates, operands, inputs, outputs=("Fac", "Color"), **properties):
    """Assert that the op gives the same number and colour as the node in Cycles."""
    number, color = run_op(op, immediates, operands)
    for name, found in zip(outputs, (np.repeat(number[:, None], 3, 1), color)):
        expected = cycles.values(kind, inputs, name, **properties)
        error = np.abs(found.astype(float) - expected) / np.maximum(1, np.abs(expected))
        assert error.max() <= TOLERANCE, f"{name}: {error.max()} at point {error.max(1).argmax()}"
        assert np.ptp(expected) > 0


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", list(FractalKind))
def test_noise(cycles, kind, dimensions, place):
    vector, w, more = inputs_at(
        place,
        Scale=(-5, 5),
        Detail=(-0.5, 15.5),
        Roughness=(-0.1, 1),
        Lacunarity=(0, 3),
        Offset=(-1, 2),
        Gain=(0, 3),
        Distortion=(-3, 3),
    )
    operands = {1: [w], 2: [vector], 3: [vector], 4: [vector, w]}[dimensions]
    inputs = ({} if dimensions == 1 else {"Vector": vector}) | ({"W": w} if dimensions in (1, 4) else {}) | more
    for normalize in (False, True) if kind == FractalKind.FBM else (False,):
        assert_same(
            cycles,
            "ShaderNodeTexNoise",
            f"noise_{dimensions}d",
            [kind, normalize],
            [*operands, *more.values()],
            inputs,
            noise_dimensions=f"{dimensions}D",
            noise_type=kind.name,
            normalize=normalize,
        )


@pytest.mark.parametrize("place", ["cells", "1e7"])
@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
def test_white_noise(cycles, dimensions, place):
    vector, w, _ = inputs_at(place)
    inputs = ({} if dimensions == 1 else {"Vector": vector}) | ({"W": w} if dimensions in (1, 4) else {})
    assert_same(
        cycles,
        "ShaderNodeTexWhiteNoise",
        "white_noise",
        [dimensions],
        [vector, w],
        inputs,
        ("Value", "Color"),
        noise_dimensions=f"{dimensions}D",
    )


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", list(WaveKind))
def test_wave(cycles, kind, place):
    vector, _, more = inputs_at(
        place,
        Scale=(0, 5),
        Phase=(-10, 10),
        Distortion=(-5, 5),
        Detail=(0, 6),
        **{"Detail Scale": (-2, 2), "Detail Roughness": (0, 1)},
    )
    still = more | {"Phase": np.zeros(COUNT), "Distortion": np.zeros(COUNT)}
    wave_type, direction = kind.name.split("_")
    for profile, name in PROFILES.items():
        for numbers in (more, still) if place == "1e7" else (more,):
            inputs = {"Vector": vector, "Phase Offset": numbers["Phase"]} | {
                key: each for key, each in numbers.items() if key != "Phase"
            }
            assert_same(
                cycles,
                "ShaderNodeTexWave",
                "wave",
                [kind, profile],
                [vector, *numbers.values()],
                inputs,
                wave_type=wave_type,
                wave_profile=name,
                **{f"{wave_type.lower()}_direction": direction},
            )


@pytest.mark.parametrize("place", PLACES)
def test_magic(cycles, place):
    vector, _, more = inputs_at(place, Scale=(-5, 5), Distortion=(-3, 3))
    for depth in range(11):
        operands = [vector, *more.values()]
        assert_same(
            cycles, "ShaderNodeTexMagic", "magic", [depth], operands, {"Vector": vector} | more, turbulence_depth=depth
        )


@pytest.mark.parametrize("place", PLACES)
def test_gradient(cycles, place):
    vector, _, _ = inputs_at(place)
    if place == "near":
        vector = vector / 10
    vector[:5] = [(0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 0.5, 0), (0.25, -0.25, 0)]
    for kind in GradientKind:
        assert_same(
            cycles, "ShaderNodeTexGradient", "gradient", [kind], [vector], {"Vector": vector}, gradient_type=kind.name
        )


@pytest.mark.parametrize("place", PLACES)
def test_checker(cycles, place):
    vector, _, more = inputs_at(place, Color1=(0, 1, 3), Color2=(0, 1, 3), Scale=(-5, 5))
    assert_same(cycles, "ShaderNodeTexChecker", "checker", [], [vector, *more.values()], {"Vector": vector} | more)


@pytest.mark.parametrize("laid", [(0.5, 2, 1.0, 2), (0.3, 1, 1.7, 3), (1.0, 3, 0.4, 2), (0.0, 2, 0.0, 2)])
@pytest.mark.parametrize("place", PLACES)
def test_brick(cycles, place, laid):
    usual = {
        "Scale": (0.5, 5),
        "Mortar Size": (0, 0.125),
        "Mortar Smooth": (0, 1),
        "Bias": (-1, 1),
        "Brick Width": (0.1, 2),
        "Row Height": (0.1, 2),
    }
    unusual = {
        "Scale": (-5, 5),
        "Mortar Size": (-0.1, 1),
        "Mortar Smooth": (-0.1, 1),
        "Bias": (-1, 1),
        "Brick Width": (-1, 2),
        "Row Height": (-1, 2),
    }
    offset, offset_frequency, squash, squash_frequency = laid
    for ranges in (usual, unusual):
        vector, _, more = inputs_at(place, Color1=(0, 1, 3), Color2=(0, 1, 3), Mortar=(0, 1, 3), **ranges)
        operands = [vector, *more.values(), offset, squash]
        assert_same(
            cycles,
            "ShaderNodeTexBrick",
            "brick",
            [offset_frequency, squash_frequency],
            operands,
            {"Vector": vector} | more,
            offset=offset,
            offset_frequency=offset_frequency,
            squash=squash,
            squash_frequency=squash_frequency,
        )


# --- coordinates of a node

UNMAPPED = {
    "vector_type": "POINT",
    "translation": (0, 0, 0),
    "rotation": (0, 0, 0),
    "scale": (1, 1, 1),
    "mapping_x": "X",
    "mapping_y": "Y",
    "mapping_z": "Z",
}
MOVED = {"translation": (0.1, 0.2, 0.3), "rotation": (0.3, -0.4, 0.5), "scale": (2.0, 0.5, 1.25)}
MAPPINGS = [
    *({"vector_type": kind} | MOVED for kind in ("POINT", "TEXTURE", "VECTOR", "NORMAL")),
    {"mapping_x": "Y", "mapping_y": "Z", "mapping_z": "NONE"} | MOVED,
    {"vector_type": "NORMAL", "scale": (3, 1, 1)},
    {"mapping_y": "NONE"},
    {"translation": (0, 0, -2)},
    {"scale": (0, 2, 0)},
]


@pytest.mark.parametrize("mapping", MAPPINGS)
def test_the_mapping_of_a_node(cycles, mapping):
    vector = np.random.default_rng(RNG_SEED).uniform(-1, 1, (COUNT, 3)).astype(np.float32)
    expected = cycles.values(
        "ShaderNodeTexMagic", {"Vector": vector, "Scale": 0.5}, "Color", mapping=mapping, turbulence_depth=1
    )
    matrix, offset = affine_of(SimpleNamespace(**UNMAPPED | mapping))
    (place,) = run_op("affine", [mapping.get("vector_type") == "NORMAL"], [vector, *matrix, offset])
    assert np.abs(run_op("magic", [1], [place, 0.5, 1.0])[1] - expected).max() <= TOLERANCE


KINDS = ["Noise", "Wave", "Magic", "Gradient", "Checker", "Brick"]


def ops_of(kind, inputs=None, mapping=None, **properties):
    """Names of the ops of a graph that emits the colour of a node.

    `inputs(graph)` gives the node's inputs.
    """
    material = bpy.data.materials.new("Ops")
    tree, surface = node_tree(material)
    graph = Graph(tree)
    node = graph.node(kind, inputs and inputs(graph), **properties)
    for name, value in (mapping or {}).items():
        setattr(node.texture_mapping, name, value)
    graph.set(surface, graph.value("ShaderNodeEmission", {"Color": node.outputs["Color"]}))
    compiled = compile_graph(surface, material, Collections())
    assert not compiled.notes
    return {step.op for step in compiled.program.instructions} if compiled.program else set()


@pytest.mark.parametrize("kind", KINDS)
def test_without_a_link_textures_look_at_generated_coordinates(addon, kind):
    plain = ops_of(f"ShaderNodeTex{kind}")
    assert "generated" in plain and "affine" not in plain
    assert "affine" in ops_of(f"ShaderNodeTex{kind}", mapping={"scale": (1, 2, 1)})


def test_without_a_link_white_noise_looks_at_one_point(addon):
    ops = ops_of("ShaderNodeTexWhiteNoise")
    assert "white_noise" in ops and "generated" not in ops


@pytest.mark.parametrize("dimensions", ["1D", "2D", "3D", "4D"])
def test_each_number_of_dimensions_has_its_op(addon, dimensions):
    # Blender would make a constant of a constant
    varying = (lambda graph: {"W": graph.x}) if dimensions == "1D" else None
    ops = ops_of("ShaderNodeTexNoise", varying, noise_dimensions=dimensions)
    assert {name for name in ops if name.startswith("noise")} == {f"noise_{dimensions.lower()}"}
    assert ("generated" in ops) == (dimensions != "1D")
