"""Procedural textures, alone."""

from tests.blender.features.graph import Graph
from tests.blender.features.registry import feature

COORDINATES = ("1D", "2D", "3D", "4D")
COLORS = {"Color1": (0.8, 0.3, 0.1), "Color2": (0.1, 0.4, 0.9)}


def coordinates(graph: Graph, dimensions: str) -> dict:
    """The coordinates of a texture of that many dimensions."""
    inputs = {} if dimensions == "1D" else {"Vector": graph.point}
    return inputs | ({"W": graph.x} if dimensions in ("1D", "4D") else {})


# --- noise

NOISE = {
    "FBM": {},
    "MULTIFRACTAL": {},
    "HYBRID_MULTIFRACTAL": {"Offset": 0.3, "Gain": 1.4},
    "RIDGED_MULTIFRACTAL": {"Offset": 0.8, "Gain": 1.2},
    "HETERO_TERRAIN": {"Offset": 0.4},
}


def _noise(kind: str, more: dict) -> None:
    @feature(
        f"Noise Texture: {kind.replace('_', ' ').lower()}",
        "Textures",
        "node",
        variants=COORDINATES,
        quick=kind == "FBM",
    )
    def build(graph: Graph, dimensions: str):
        inputs = (
            coordinates(graph, dimensions) | {"Scale": 2.75, "Detail": 2.6, "Roughness": 0.55, "Lacunarity": 2.1} | more
        )
        return graph.outputs(graph.node("ShaderNodeTexNoise", inputs, noise_dimensions=dimensions, noise_type=kind))


for _kind, _more in NOISE.items():
    _noise(_kind, _more)


@feature("Noise Texture: distortion", "Textures", "node", variants=COORDINATES)
def noise_distortion(graph: Graph, dimensions: str):
    inputs = coordinates(graph, dimensions) | {"Scale": 1.5, "Detail": 1.0, "Distortion": 0.7}
    return graph.outputs(graph.node("ShaderNodeTexNoise", inputs, noise_dimensions=dimensions))


@feature("Noise Texture: linked detail, not normalized", "Textures", "node", variants=("FBM", "HETERO_TERRAIN"))
def noise_linked(graph: Graph, kind: str):
    detail = graph.math("MULTIPLY_ADD", graph.y, 2.0, 3.0)
    inputs = {"Vector": graph.point, "Scale": 3.0, "Detail": detail, "Roughness": graph.math("ABSOLUTE", graph.z)}
    return graph.outputs(graph.node("ShaderNodeTexNoise", inputs, noise_type=kind, normalize=False))


@feature("Noise Texture: far away", "Textures", "node", variants=COORDINATES)
def noise_far(graph: Graph, dimensions: str):
    far = {
        name: graph.math("ADD", socket, 100000.0) if name == "W" else graph.vector_math("ADD", socket, (1e5, -2e5, 3e5))
        for name, socket in coordinates(graph, dimensions).items()
    }
    return graph.outputs(
        graph.node("ShaderNodeTexNoise", far | {"Scale": 2.0, "Detail": 2.0}, noise_dimensions=dimensions)
    )


# --- Voronoi


def _voronoi(name: str, kinds: tuple, quick: bool = False, **more) -> None:
    @feature(f"Voronoi Texture: {name}", "Textures", "node", variants=kinds, quick=quick)
    def build(graph: Graph, variant: tuple):
        kind, metric, dimensions = variant
        inputs = coordinates(graph, dimensions) | {"Scale": 2.25, "Randomness": 0.9, "Smoothness": 0.6, "Exponent": 1.7}
        inputs |= {key: value for key, value in more.items() if key[0].isupper()}
        properties = {key: value for key, value in more.items() if key[0].islower()}
        node = graph.node(
            "ShaderNodeTexVoronoi", None, voronoi_dimensions=dimensions, feature=kind, distance=metric, **properties
        )
        graph.fill(node, inputs)
        return graph.outputs(node)


for _name, _kind in (("F1", "F1"), ("F2", "F2"), ("smooth F1", "SMOOTH_F1")):
    _voronoi(_name, tuple((_kind, "EUCLIDEAN", each) for each in COORDINATES), quick=_kind == "F1")
_voronoi("distance to edge", tuple(("DISTANCE_TO_EDGE", "EUCLIDEAN", each) for each in COORDINATES))
_voronoi("n-sphere radius", tuple(("N_SPHERE_RADIUS", "EUCLIDEAN", each) for each in COORDINATES))
for _metric in ("MANHATTAN", "CHEBYCHEV", "MINKOWSKI"):
    _voronoi(_metric.title(), (("F1", _metric, "2D"), ("F2", _metric, "3D"), ("SMOOTH_F1", _metric, "4D")))
_voronoi(
    "detail",
    (("F1", "EUCLIDEAN", "3D"), ("F2", "EUCLIDEAN", "2D"), ("DISTANCE_TO_EDGE", "EUCLIDEAN", "2D")),
    Detail=2.4,
    Roughness=0.6,
    Lacunarity=1.8,
)
_voronoi(
    "detail, normalized",
    (("F1", "EUCLIDEAN", "4D"), ("SMOOTH_F1", "CHEBYCHEV", "3D"), ("DISTANCE_TO_EDGE", "EUCLIDEAN", "3D")),
    Detail=1.5,
    normalize=True,
)


# --- wave, magic, checker, brick, gradient, white noise, gabor


@feature("Wave Texture: bands", "Textures", "node", variants=("X", "Y", "Z", "DIAGONAL"), quick=True)
def wave_bands(graph: Graph, direction: str):
    return graph.outputs(
        graph.node(
            "ShaderNodeTexWave", {"Vector": graph.point, "Scale": 0.7, "Phase Offset": 0.3}, bands_direction=direction
        )
    )


@feature("Wave Texture: rings", "Textures", "node", variants=("X", "Y", "Z", "SPHERICAL"))
def wave_rings(graph: Graph, direction: str):
    return graph.outputs(
        graph.node(
            "ShaderNodeTexWave", {"Vector": graph.point, "Scale": 0.7}, wave_type="RINGS", rings_direction=direction
        )
    )


@feature("Wave Texture: profiles and distortion", "Textures", "node", variants=("SIN", "SAW", "TRI"))
def wave_distortion(graph: Graph, profile: str):
    inputs = {
        "Vector": graph.point,
        "Scale": 0.6,
        "Distortion": 1.2,
        "Detail": 2.5,
        "Detail Scale": 1.3,
        "Detail Roughness": 0.6,
    }
    return graph.outputs(graph.node("ShaderNodeTexWave", inputs, wave_profile=profile))


@feature("Magic Texture", "Textures", "node", variants=tuple(range(0, 11, 2)), quick=True)
def magic(graph: Graph, depth: int):
    return graph.outputs(
        graph.node(
            "ShaderNodeTexMagic", {"Vector": graph.point, "Scale": 1.7, "Distortion": 1.3}, turbulence_depth=depth
        )
    )


@feature("Checker Texture", "Textures", "node", variants=(5.0, 3.3), quick=True)
def checker(graph: Graph, scale: float):
    return graph.outputs(graph.node("ShaderNodeTexChecker", {"Vector": graph.point, "Scale": scale} | COLORS))


@feature("Brick Texture", "Textures", "node", variants=((0.5, 2, 1.0, 2), (0.3, 3, 0.6, 4)), quick=True)
def brick(graph: Graph, variant: tuple):
    offset, offset_frequency, squash, squash_frequency = variant
    inputs = {
        "Vector": graph.point,
        "Mortar": (0.2, 0.9, 0.3),
        "Scale": 2.3,
        "Mortar Size": 0.04,
        "Mortar Smooth": 0.3,
        "Bias": 0.1,
    }
    node = graph.node(
        "ShaderNodeTexBrick",
        inputs | COLORS,
        offset=offset,
        offset_frequency=offset_frequency,
        squash=squash,
        squash_frequency=squash_frequency,
    )
    return graph.outputs(node)


@feature(
    "Gradient Texture",
    "Textures",
    "node",
    quick=True,
    variants=("LINEAR", "QUADRATIC", "EASING", "DIAGONAL", "SPHERICAL", "QUADRATIC_SPHERE", "RADIAL"),
)
def gradient(graph: Graph, kind: str):
    return graph.value("ShaderNodeTexGradient", {"Vector": graph.point}, "Fac", gradient_type=kind)


@feature("White Noise Texture", "Textures", "node", variants=COORDINATES, quick=True)
def white_noise(graph: Graph, dimensions: str):
    return graph.outputs(
        graph.node("ShaderNodeTexWhiteNoise", coordinates(graph, dimensions), noise_dimensions=dimensions)
    )


@feature("Gabor Texture", "Textures", "node", variants=(("2D", 1.0), ("3D", 1.0), ("2D", 0.3), ("3D", 0.0)))
def gabor(graph: Graph, variant: tuple):
    kind, anisotropy = variant
    inputs = {"Vector": graph.point, "Scale": 2.5, "Frequency": 1.7, "Anisotropy": anisotropy}
    inputs |= {"Orientation 2D": 0.6, "Orientation 3D": (0.4, 0.9, 0.3)}
    return graph.outputs(graph.fill(graph.node("ShaderNodeTexGabor", gabor_type=kind), inputs))
