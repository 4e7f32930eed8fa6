"""Directional albedos of GGX lobes: what share of the light from wo leaves again after one bounce.

What single scattering loses is given back by scaling a lobe (Turquin, "Practical multiple scattering
compensation for microfacet models", 2019, with the colour of Kulla and Conty, "Revisiting Physically
Based Shading at Imageworks", 2017), and what a coat reflects is withheld from the layer below.

`albedo.npz` is made by scripts/make_albedo_tables.py. Its axes are even in: the roughness; the index
coordinate sign(x) |x|^(1/4) with x = log(eta) / log(1000), which is fine near 1, where total reflection
and Fresnel's rise to it crowd at grazing angles; and the cosine coordinate sqrt(mu (1 + alpha) / (mu + alpha)),
since albedos change over cosines of the order of alpha. A coat's albedo follows Fresnel's equations at
about sqrt(mu^2 + alpha^2 (1 - mu^2)), and its table holds the difference.

Entries are raised so far that interpolation is below the truth nowhere at several places of each cell: what
errs loses light, and does not make it, which many bounces would multiply. Largest losses found at cosines
above 0.1: 0.002 for F = 1 and for a coat; for glass, relative to the albedo, 0.03 from inside and near an
index of 1; at cosines below 0.03 up to 0.15 for a coat, and from inside rough glass of an index near 1, where
single scattering ends on the wrong side, any. Largest gains, at random places: 5e-4 for F = 1, 1e-5 for a
coat (2e-3 at cosines below 0.001), 2e-3 for glass (0.011 there).
"""

import functools
import math
from pathlib import Path

import numpy as np
import warp as wp

from .film import load_film
from .fresnel import fresnel_dielectric
from .microfacet import ggx_slope
from .sheen import load_sheen

_FILE = Path(__file__).with_name("albedo.npz")


@wp.struct
class AlbedoTables:
    """Albedos in [0, 1] and a difference of two, float32; those that a scene does not need have length 0."""

    reflection: wp.array2d(dtype=float)  # F = 1; [roughness, cosine]
    reflection_average: wp.array(dtype=float)  # its cosine-weighted mean; [roughness]
    # mean reflectance of the visible facets, those of all light as weights, less that of one at `ggx_slope`; in [-1, 1]
    coat: wp.array3d(dtype=float)  # [index >= 1, roughness, cosine]
    fresnel_average: wp.array(dtype=float)  # cosine-weighted mean of the Fresnel factor; [index >= 1]
    glass: wp.array3d(dtype=float)  # reflection + refraction; [index, roughness, cosine]
    glass_average: wp.array2d(dtype=float)  # its cosine-weighted mean; [index, roughness]
    film: wp.array3d(dtype=float)  # transforms of the channels' sensitivities (`film.py`); [channel, detour, 2]
    sheen: wp.array3d(dtype=float)  # albedo, scale and tilt of a layer of fibres (`sheen.py`); [3, roughness, cosine]


@functools.cache
def load_tables() -> dict[str, np.ndarray]:
    """The arrays of `AlbedoTables` by name, float32."""
    with np.load(_FILE) as file:
        tables = {name: file[name] / np.float64(np.iinfo(file[name].dtype).max) for name in file.files}
    tables["glass_average"] = _average_over_cosines(tables["glass"])
    tables["sheen"], tables["film"] = load_sheen(), load_film()
    return {name: table.astype(np.float32) for name, table in tables.items()}


def _average_over_cosines(table: np.ndarray) -> np.ndarray:
    """Cosine-weighted means of a table whose last axes are the roughness and the cosine coordinate, by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    cosine, weight = (nodes + 1) / 2, weights / 2
    means = np.empty(table.shape[:-1])
    for r in range(table.shape[-2]):
        alpha = (r / (table.shape[-2] - 1)) ** 2
        place = np.sqrt(cosine * (1 + alpha) / (cosine + alpha)) * (table.shape[-1] - 1)
        cell = np.minimum(place.astype(int), table.shape[-1] - 2)
        row = table[..., r, :]
        values = row[..., cell] + (row[..., cell + 1] - row[..., cell]) * (place - cell)
        means[..., r] = (values * 2 * cosine * weight).sum(-1)
    return means


def upload_tables(device, reflection: bool, coat: bool, glass: bool, sheen: bool, film: bool = False) -> AlbedoTables:
    """The tables that are asked for, on `device`. A coat needs `reflection` too."""
    wanted = {
        "reflection": reflection, "reflection_average": reflection,
        "coat": coat, "fresnel_average": coat,
        "glass": glass, "glass_average": glass, "sheen": sheen, "film": film,
    }  # fmt: skip
    dimensions = {"reflection": 2, "coat": 3, "glass": 3, "glass_average": 2, "sheen": 3, "film": 3}
    tables = AlbedoTables()
    for name, there in wanted.items():
        values = load_tables()[name] if there else np.zeros((0,) * dimensions.get(name, 1), np.float32)
        setattr(tables, name, wp.array(values, dtype=float, device=device))
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
def _cell(place: float, count: int) -> int:
    return wp.clamp(int(place), 0, count - 2)


@wp.func
def _read_1d(table: wp.array(dtype=float), x: float) -> float:
    place = wp.clamp(x, 0.0, 1.0) * float(table.shape[0] - 1)
    i = _cell(place, table.shape[0])
    return wp.lerp(table[i], table[i + 1], place - float(i))


@wp.func
def _read_2d(table: wp.array2d(dtype=float), x: float, y: float) -> float:
    place = wp.clamp(x, 0.0, 1.0) * float(table.shape[0] - 1)
    i = _cell(place, table.shape[0])
    return wp.lerp(_read_1d(table[i], y), _read_1d(table[i + 1], y), place - float(i))


@wp.func
def _read_3d(table: wp.array3d(dtype=float), x: float, y: float, z: float) -> float:
    place = wp.clamp(x, 0.0, 1.0) * float(table.shape[0] - 1)
    i = _cell(place, table.shape[0])
    return wp.lerp(_read_2d(table[i], y, z), _read_2d(table[i + 1], y, z), place - float(i))


@wp.func
def reflection_albedo(tables: AlbedoTables, roughness: float, cosine: float) -> float:
    """GGX reflection with F = 1, single scattering; > 0."""
    return _read_2d(tables.reflection, roughness, _cosine_coordinate(roughness, cosine))


@wp.func
def coat_fresnel(tables: AlbedoTables, roughness: float, ior: float, cosine: float) -> float:
    """Mean reflectance of the facets of a dielectric of `ior` >= 1 that are seen from `cosine`, by how much light they would reflect."""
    difference = _read_3d(tables.coat, _index_coordinate(ior), roughness, _cosine_coordinate(roughness, cosine))
    return wp.clamp(fresnel_dielectric(ggx_slope(roughness * roughness, cosine), ior) + difference, 0.0, 1.0)


@wp.func
def coat_albedo(tables: AlbedoTables, roughness: float, ior: float, cosine: float) -> float:
    """GGX reflection off a dielectric of `ior` >= 1, single scattering."""
    return reflection_albedo(tables, roughness, cosine) * coat_fresnel(tables, roughness, ior, cosine)


@wp.func
def glass_albedo(tables: AlbedoTables, roughness: float, eta: float, cosine: float) -> float:
    """GGX reflection and refraction together, single scattering; > 0. `eta`: far side over near side."""
    x = 0.5 + 0.5 * _index_coordinate(eta)
    return _read_3d(tables.glass, x, roughness, _cosine_coordinate(roughness, cosine))


@wp.func
def coat_fresnel_average(tables: AlbedoTables, ior: float) -> float:
    """Cosine-weighted mean over the hemisphere of the reflectance of a dielectric.

    As much light crosses it from one side as from the other, of radiances that differ by the squared index.
    """
    if ior < 1.0:
        return 1.0 - ior * ior * (1.0 - _read_1d(tables.fresnel_average, _index_coordinate(1.0 / ior)))
    return _read_1d(tables.fresnel_average, _index_coordinate(ior))


@wp.func
def covering_index(ior: float) -> float:
    """The index >= 1 by which a dielectric layer of `ior` takes light from what is below.

    That of a layer of an index below 1 is the inverse, as in Cycles: total reflection darkens nothing, so that such a surface gives
    back more light than came. No such layer is above a denser base in the world.
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
def glass_compensation(tables: AlbedoTables, roughness: float, eta: float, cosine: float, colour: wp.vec3) -> wp.vec3:
    """The same of glass, in which what bounces between facets takes `colour`."""
    average = _read_2d(tables.glass_average, 0.5 + 0.5 * _index_coordinate(eta), roughness)
    return _compensation(glass_albedo(tables, roughness, eta, cosine), average, colour)


@wp.func
def _compensation(e: float, average: float, fresnel: wp.vec3) -> wp.vec3:
    return wp.vec3(1.0) + ((1.0 - e) / e) * wp.cw_div(average * fresnel, wp.vec3(1.0) - (1.0 - average) * fresnel)
