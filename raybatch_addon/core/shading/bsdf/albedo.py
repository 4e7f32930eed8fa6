"""Directional albedos of GGX lobes: the share of the light from wo that leaves again after one bounce.

What single scattering loses is given back by scaling a lobe (Turquin, "Practical multiple scattering compensation for
microfacet models", 2019, with the colour of Kulla and Conty, "Revisiting Physically Based Shading at Imageworks",
2017). What a coat reflects is withheld from the layer below.

scripts/precompute/albedo_tables.py makes `albedo.npz`. Its axes have even steps in three coordinates:

- the roughness;
- the index coordinate sign(x) |x|^(1/4) with x = log(eta) / log(1000). It is fine near 1, where total reflection and
  Fresnel's rise to it crowd at grazing angles;
- the cosine coordinate sqrt(mu (1 + alpha) / (mu + alpha)), since albedos change over cosines of the order of alpha.

A coat's albedo follows Fresnel's equations at about sqrt(mu^2 + alpha^2 (1 - mu^2)); its table holds the difference.

Entries are raised until interpolation is nowhere below the truth at several test points of each cell. So an error loses
light instead of making it, which many bounces would multiply. Largest losses found at cosines above 0.1: 0.002 for F =
1 and for a coat; for glass, relative to the albedo, 0.03 from inside and near an index of 1. At cosines below 0.03 a
coat loses up to 0.15. From inside rough glass of an index near 1, single scattering ends on the wrong side, and any
share may be lost. Largest gains, at random points: 5e-4 for F = 1, 1e-5 for a coat (2e-3 at cosines below 0.001), 2e-3
for glass (0.011 there).
"""

import functools
import math
from pathlib import Path

import numpy as np
import warp as wp

from ...native.structs import Upload, upload_anew
from .fresnel import fresnel_dielectric
from .ggx import ggx_slope
from .sheen import load_sheen
from .thin_film import load_film

_FILE = Path(__file__).with_name("albedo.npz")


@wp.struct
class AlbedoTables:
    """Tables of albedos in [0, 1] and of a difference of two, float32; tables that a scene does not need are empty."""

    reflection: wp.array2d(dtype=float)  # F = 1; [roughness, cosine]
    reflection_average: wp.array(dtype=float)  # its cosine-weighted mean; [roughness]
    # mean reflectance of the visible facets, weighted by the light that each would reflect, less the reflectance of
    # one facet at `ggx_slope`; in [-1, 1]
    coat: wp.array3d(dtype=float)  # [index >= 1, roughness, cosine]
    fresnel_average: wp.array(dtype=float)  # cosine-weighted mean of the Fresnel factor; [index >= 1]
    glass: wp.array3d(dtype=float)  # reflection + refraction; [index, roughness, cosine]
    glass_average: wp.array2d(dtype=float)  # its cosine-weighted mean; [index, roughness]
    film: wp.array3d(dtype=float)  # transforms of the channels' sensitivities (`thin_film.py`); [channel, detour, 2]
    sheen: wp.array3d(dtype=float)  # albedo, scale and tilt of a layer of fibres (`sheen.py`); [3, roughness, cosine]


@functools.cache
def load_table(name: str) -> np.ndarray:
    """The array `name` of `AlbedoTables`, float32; made when it is asked for, as most scenes need few of them."""
    if name in ("sheen", "film"):
        return load_sheen() if name == "sheen" else load_film()
    if name == "glass_average":
        return _average_over_cosines(_stored("glass")).astype(np.float32)
    return _stored(name).astype(np.float32)


def _stored(name: str) -> np.ndarray:
    """A table of the file, float64."""
    with np.load(_FILE) as file:
        table = file[name]
    return table / np.float64(np.iinfo(table.dtype).max)


def _average_over_cosines(table: np.ndarray) -> np.ndarray:
    """Cosine-weighted means, by Gauss-Legendre quadrature.

    The last two axes of `table` are the roughness and the cosine coordinate; the result lacks the last.
    """
    nodes, weights = np.polynomial.legendre.leggauss(64)
    cosine, weight = (nodes + 1) / 2, weights / 2
    means = np.empty(table.shape[:-1])
    for r in range(table.shape[-2]):
        alpha = (r / (table.shape[-2] - 1)) ** 2
        position = np.sqrt(cosine * (1 + alpha) / (cosine + alpha)) * (table.shape[-1] - 1)
        cell = np.minimum(position.astype(int), table.shape[-1] - 2)
        row = table[..., r, :]
        values = row[..., cell] + (row[..., cell + 1] - row[..., cell]) * (position - cell)
        means[..., r] = (values * 2 * cosine * weight).sum(-1)
    return means


def upload_tables(
    device, reflection: bool, coat: bool, glass: bool, sheen: bool, film: bool = False, upload: Upload = upload_anew
) -> AlbedoTables:
    """The tables that are asked for, on `device`, each copied there by `upload`. A coat needs `reflection` too."""
    wanted = {
        "reflection": reflection,
        "reflection_average": reflection,
        "coat": coat,
        "fresnel_average": coat,
        "glass": glass,
        "glass_average": glass,
        "sheen": sheen,
        "film": film,
    }
    dimensions = {"reflection": 2, "coat": 3, "glass": 3, "glass_average": 2, "sheen": 3, "film": 3}
    tables = AlbedoTables()
    for name, there in wanted.items():
        values = load_table(name) if there else np.zeros((0,) * dimensions.get(name, 1), np.float32)
        setattr(tables, name, upload(f"albedo {name}", values, float, device))
    return tables


@wp.func
def _index_coordinate(eta: float) -> float:
    x = wp.log(eta) * wp.static(1.0 / math.log(1000.0))
    return wp.sign(x) * wp.sqrt(wp.sqrt(wp.abs(x)))


@wp.func
def _cosine_coordinate(roughness: float, cosine: float) -> float:
    alpha = roughness * roughness
    return wp.sqrt(wp.clamp(cosine * (1.0 + alpha) / wp.max(cosine + alpha, cosine * (1.0 + alpha)), 0.0, 1.0))


@wp.func
def _cell(position: float, count: int) -> int:
    return wp.clamp(int(position), 0, count - 2)


@wp.func
def _read_1d(table: wp.array(dtype=float), x: float) -> float:
    position = wp.clamp(x, 0.0, 1.0) * float(table.shape[0] - 1)
    i = _cell(position, table.shape[0])
    return wp.lerp(table[i], table[i + 1], position - float(i))


@wp.func
def _read_2d(table: wp.array2d(dtype=float), x: float, y: float) -> float:
    position = wp.clamp(x, 0.0, 1.0) * float(table.shape[0] - 1)
    i = _cell(position, table.shape[0])
    return wp.lerp(_read_1d(table[i], y), _read_1d(table[i + 1], y), position - float(i))


@wp.func
def _read_3d(table: wp.array3d(dtype=float), x: float, y: float, z: float) -> float:
    position = wp.clamp(x, 0.0, 1.0) * float(table.shape[0] - 1)
    i = _cell(position, table.shape[0])
    return wp.lerp(_read_2d(table[i], y, z), _read_2d(table[i + 1], y, z), position - float(i))


@wp.func
def reflection_albedo(tables: AlbedoTables, roughness: float, cosine: float) -> float:
    """Albedo of GGX reflection with F = 1, single scattering; > 0."""
    return _read_2d(tables.reflection, roughness, _cosine_coordinate(roughness, cosine))


@wp.func
def coat_fresnel(tables: AlbedoTables, roughness: float, ior: float, cosine: float) -> float:
    """Mean reflectance of the facets of a dielectric of `ior` >= 1 that are seen from `cosine`.

    A facet's weight is the light that it would reflect at F = 1.
    """
    difference = _read_3d(tables.coat, _index_coordinate(ior), roughness, _cosine_coordinate(roughness, cosine))
    return wp.clamp(fresnel_dielectric(ggx_slope(roughness * roughness, cosine), ior) + difference, 0.0, 1.0)


@wp.func
def coat_albedo(tables: AlbedoTables, roughness: float, ior: float, cosine: float) -> float:
    """Albedo of GGX reflection off a dielectric of `ior` >= 1, single scattering."""
    return reflection_albedo(tables, roughness, cosine) * coat_fresnel(tables, roughness, ior, cosine)


@wp.func
def glass_albedo(tables: AlbedoTables, roughness: float, eta: float, cosine: float) -> float:
    """Albedo of GGX reflection and refraction together, single scattering; > 0. `eta`: far side over near side."""
    x = 0.5 + 0.5 * _index_coordinate(eta)
    return _read_3d(tables.glass, x, roughness, _cosine_coordinate(roughness, cosine))


@wp.func
def coat_fresnel_average(tables: AlbedoTables, ior: float) -> float:
    """Cosine-weighted mean over the hemisphere of the reflectance of a dielectric.

    As much light crosses the surface from one side as from the other; the radiances differ by the squared index.
    """
    if ior < 1.0:
        return 1.0 - ior * ior * (1.0 - _read_1d(tables.fresnel_average, _index_coordinate(1.0 / ior)))
    return _read_1d(tables.fresnel_average, _index_coordinate(ior))


@wp.func
def covering_index(ior: float) -> float:
    """The index >= 1 by which a dielectric layer of `ior` takes light from what is below.

    A layer of an index below 1 acts by the inverse, as in Cycles: total reflection darkens nothing, so that such a
    surface gives back more light than came. In the world no such layer lies above a denser base.
    """
    if ior < 1.0:
        return 1.0 / ior
    return ior


@wp.func
def energy_compensation(tables: AlbedoTables, roughness: float, cosine: float, fresnel: wp.vec3) -> wp.vec3:
    """Factor of a reflection lobe that adds what bounces more than once between its facets.

    `fresnel` in [0, 1]: mean reflectance of the facets; 0 gives 1, and 1 gives one over the albedo.
    """
    average = _read_1d(tables.reflection_average, roughness)
    return _compensation(reflection_albedo(tables, roughness, cosine), average, fresnel)


@wp.func
def glass_compensation(tables: AlbedoTables, roughness: float, eta: float, cosine: float, color: wp.vec3) -> wp.vec3:
    """Factor of a glass lobe that adds what bounces more than once between its facets; such light takes `color`."""
    average = _read_2d(tables.glass_average, 0.5 + 0.5 * _index_coordinate(eta), roughness)
    return _compensation(glass_albedo(tables, roughness, eta, cosine), average, color)


@wp.func
def _compensation(e: float, average: float, fresnel: wp.vec3) -> wp.vec3:
    return wp.vec3(1.0) + ((1.0 - e) / e) * wp.cw_div(average * fresnel, wp.vec3(1.0) - (1.0 - average) * fresnel)
