"""Ops of Voronoi textures: one for each feature in each number of dimensions (`voronoi_3d_f1`).

Thus kernels hold only the loops that a scene needs; metrics are immediates.
"""

import warp as wp

from ....op import NodeData, number, op, put_number, put_vector, vector
from ....point import ShadingPoint
from .features import FEATURES, VoronoiSettings, make_distance_to_edge, make_n_sphere_radius, make_voronoi


@wp.func
def _settings(data: NodeData, stack: wp.array(dtype=float), pc: int) -> VoronoiSettings:
    """Settings from the words that all these ops share."""
    settings = VoronoiSettings()
    settings.metric = data.code[pc + 1]
    settings.normalize = data.code[pc + 2]
    settings.scale = number(data, stack, pc + 5)
    settings.detail = number(data, stack, pc + 6)
    settings.roughness = number(data, stack, pc + 7)
    settings.lacunarity = number(data, stack, pc + 8)
    settings.smoothness = number(data, stack, pc + 9)
    settings.exponent = number(data, stack, pc + 10)
    settings.randomness = number(data, stack, pc + 11)
    return settings


def op_name(dimensions: int, feature: str) -> str:
    """Name of the op for `feature` (one of `FEATURES`)."""
    return f"voronoi_{dimensions}d_{feature}"


# metric, normalize, xyz, w, scale, detail, roughness, lacunarity, smoothness, exponent, randomness > ...
_WORDS = "iivnnnnnnnn"


def _register_sample(dimensions: int, feature: str) -> None:
    voronoi = make_voronoi(dimensions, feature)

    @op(op_name(dimensions, feature), _WORDS + ">NVVN", foldable=False)  # distance, colour, position, w
    @wp.func
    def sample(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
        found = voronoi(_settings(data, stack, pc), vector(data, stack, pc + 3), number(data, stack, pc + 4))
        put_number(data, stack, pc + 12, found.distance)
        put_vector(data, stack, pc + 13, found.color)
        put_vector(data, stack, pc + 14, wp.vec3(found.position[0], found.position[1], found.position[2]))
        put_number(data, stack, pc + 15, found.position[3])


def _register_number(dimensions: int, feature: str) -> None:
    evaluate = make_distance_to_edge(dimensions) if feature == "distance_to_edge" else make_n_sphere_radius(dimensions)

    @op(op_name(dimensions, feature), _WORDS + ">N", foldable=False)
    @wp.func
    def measure(data: NodeData, stack: wp.array(dtype=float), pc: int, point: ShadingPoint):
        found = evaluate(_settings(data, stack, pc), vector(data, stack, pc + 3), number(data, stack, pc + 4))
        put_number(data, stack, pc + 12, found)


for _dimensions in (1, 2, 3, 4):
    for _feature in FEATURES:
        (_register_sample if _feature in ("f1", "f2", "smooth_f1") else _register_number)(_dimensions, _feature)
