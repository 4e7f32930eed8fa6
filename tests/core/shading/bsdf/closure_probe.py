"""Materials evaluated and sampled in kernels, many directions at once, and quadrature to compare with."""

import functools
from types import SimpleNamespace

import numpy as np
import warp as wp

from raybatch_addon.core.device.codegen.local_arrays import Unset
from raybatch_addon.core.device.kernel import kernel_options, specialised_out_of_line
from raybatch_addon.core.scene.description import Closure, ClosureKind, Material
from raybatch_addon.core.shading.bsdf.albedo import AlbedoTables
from raybatch_addon.core.shading.bsdf.bsdf import (
    DELTA,
    LOBE_FLOATS,
    ClosureFeatures,
    Lobe,
    MaterialTable,
    ShadingFrame,
    make_bsdf,
    upload_materials,
)
from raybatch_addon.core.shading.bsdf.ggx import ALPHA_MIN
from raybatch_addon.core.shading.bsdf.materials import RECORD_FLOATS, BsdfSample, ClosureRecord, address_of
from raybatch_addon.core.shading.bsdf.mixture import Mixture
from raybatch_addon.core.wavefront.stages.limits import PathLimits
from raybatch_addon.core.wavefront.stages.surface.caustics import darken_glass
from tests.support.under_test import DEVICE

K = ClosureKind
OPTIONS = kernel_options(specialised_out_of_line())  # compiled as stages are that shade
# hair, which surfaces of other kinds never meet, is tested apart
EVERYTHING = ClosureFeatures(tuple(kind for kind in K if not kind.is_hair))
WHITE = (1.0, 1.0, 1.0)
UP = (0.0, 0.0, 1.0)
MOST = 32  # closures of a material here at most
SMOOTH = 0.9 * ALPHA_MIN**0.5  # roughness of a delta lobe


def halved(bsdf, half):
    """The functions of `bsdf` for glass that reflects alone or refracts alone, `half` saying which, as a path gets it
    once the closures have been looked at.
    """

    @wp.func
    def halve(closures: wp.array(dtype=ClosureRecord), first: int, end: int, own: wp.array(dtype=ClosureRecord)):
        for c in range(first, end):
            own[c - first] = closures[c]
        limits = PathLimits()
        limits.caustics_reflective = wp.static(int(half == "REFLECTS"))
        limits.caustics_refractive = wp.static(int(half == "REFRACTS"))
        darken_glass(limits, own, end - first)

    @wp.func
    def mix(
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        lobes: wp.array(dtype=Lobe),
        albedo: AlbedoTables,
        frame: ShadingFrame,
        wo: wp.vec3,
        wi: wp.vec3,
    ) -> Mixture:
        records = wp.zeros(wp.static(MOST * RECORD_FLOATS), dtype=Unset)
        own = wp.array(ptr=address_of(records), shape=(wp.static(MOST),), dtype=ClosureRecord)
        halve(closures, first, end, own)
        return bsdf.mix(own, 0, end - first, lobes, albedo, frame, wo, wi)

    @wp.func
    def propose(
        closures: wp.array(dtype=ClosureRecord),
        first: int,
        end: int,
        lobes: wp.array(dtype=Lobe),
        albedo: AlbedoTables,
        frame: ShadingFrame,
        wo: wp.vec3,
        u_lobe: float,
        u: wp.vec2,
    ) -> BsdfSample:
        records = wp.zeros(wp.static(MOST * RECORD_FLOATS), dtype=Unset)
        own = wp.array(ptr=address_of(records), shape=(wp.static(MOST),), dtype=ClosureRecord)
        halve(closures, first, end, own)
        return bsdf.propose(own, 0, end - first, lobes, albedo, frame, wo, u_lobe, u)

    return bsdf._replace(mix=mix, propose=propose)


@functools.cache
def kernels(features, half=""):
    """Kernels that evaluate and sample many directions at once; `half`: as of `halved`, or nothing."""
    bsdf = make_bsdf(features)
    if half:
        bsdf = halved(bsdf, half)

    @wp.kernel(**OPTIONS)
    def evaluate(
        table: MaterialTable,
        frame: ShadingFrame,
        wo: wp.array(dtype=wp.vec3),
        wi: wp.array(dtype=wp.vec3),
        value: wp.array(dtype=wp.vec3),
        pdf: wp.array(dtype=float),
    ):
        i = wp.tid()
        material = table.records[0]
        seen = wp.zeros(wp.static(MOST * LOBE_FLOATS), dtype=Unset)
        lobes = wp.array(ptr=address_of(seen), shape=(wp.static(MOST),), dtype=Lobe)
        bsdf.look(table.closures, material.closure_first, material.closure_end, table.albedo, frame, wo[i], lobes)
        mixture = bsdf.mix(
            table.closures, material.closure_first, material.closure_end, lobes, table.albedo, frame, wo[i], wi[i]
        )
        result = bsdf.value(mixture)
        value[i] = result.value
        pdf[i] = result.pdf

    @wp.kernel(**OPTIONS)
    def sample(
        table: MaterialTable,
        frame: ShadingFrame,
        wo: wp.array(dtype=wp.vec3),
        u: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        weight: wp.array(dtype=wp.vec3),
        pdf: wp.array(dtype=float),
        lobe: wp.array(dtype=int),
    ):
        i = wp.tid()
        first = table.records[0].closure_first
        end = table.records[0].closure_end
        seen = wp.zeros(wp.static(MOST * LOBE_FLOATS), dtype=Unset)
        lobes = wp.array(ptr=address_of(seen), shape=(wp.static(MOST),), dtype=Lobe)
        bsdf.look(table.closures, first, end, table.albedo, frame, wo[i], lobes)
        result = bsdf.propose(
            table.closures, first, end, lobes, table.albedo, frame, wo[i], u[i][0], wp.vec2(u[i][1], u[i][2])
        )
        if result.lobe != 0 and (result.lobe & wp.static(DELTA)) == 0:
            mixture = bsdf.mix(table.closures, first, end, lobes, table.albedo, frame, wo[i], result.direction)
            result = bsdf.complete(result, mixture)
        direction[i] = result.direction
        weight[i] = result.weight
        pdf[i] = result.pdf
        lobe[i] = result.lobe

    @wp.kernel(**OPTIONS)
    def constants(table: MaterialTable, out: wp.array(dtype=wp.vec3)):
        first = table.records[0].closure_first
        end = table.records[0].closure_end
        out[0] = bsdf.emission(table.closures, first, end)
        out[1] = bsdf.transparency(table.closures, first, end)
        out[2] = wp.vec3(wp.where(bsdf.scatters(table.closures, first, end), 1.0, 0.0))

    return SimpleNamespace(evaluate=evaluate, sample=sample, constants=constants)


def frame_of(normal=UP, geometric=UP, entering=1):
    """A `ShadingFrame` with normals on the side of wo."""
    n = np.asarray(normal, np.float64) / np.linalg.norm(normal)
    tangent = np.cross((0.0, 1.0, 0.0) if abs(n[1]) < 0.9 else (1.0, 0.0, 0.0), n)
    tangent /= np.linalg.norm(tangent)
    frame = ShadingFrame()
    frame.normal = wp.vec3(*n)
    frame.geometric_normal = wp.vec3(*(np.asarray(geometric) / np.linalg.norm(geometric)))
    frame.tangent = wp.vec3(*tangent)
    frame.bitangent = wp.vec3(*np.cross(n, tangent))
    frame.entering = entering
    return frame


@functools.cache
def table_of(*closures, features=EVERYTHING, device=DEVICE):
    """The device table of one material."""
    return upload_materials([Material("test", closures)], features, device)


def launch(kernel, count, inputs, outputs, device=DEVICE):
    """Run `kernel`, compiled for the device's block width."""
    width = 1 if wp.get_device(device).is_cpu else 256
    kernel.module.load(wp.get_device(device), block_dim=width)
    wp.launch(kernel, count, inputs=inputs, outputs=outputs, device=device, block_dim=width)


def vectors(values, count, device=DEVICE):
    """Device array of `values`, [3] or [count, 3]."""
    return wp.array(np.broadcast_to(np.asarray(values, np.float32), (count, 3)).copy(), dtype=wp.vec3, device=device)


def evaluate(closures, wo, wi, frame=None, features=EVERYTHING, device=DEVICE, half=""):
    """Values: value [n, 3], pdf [n]."""
    wi = np.atleast_2d(wi)
    count = len(wi)
    out = [wp.zeros(count, dtype=wp.vec3, device=device), wp.zeros(count, dtype=float, device=device)]
    table = table_of(*closures, features=features, device=device)
    arrays = [vectors(wo, count, device), vectors(wi, count, device)]
    launch(kernels(features, half).evaluate, count, [table, frame or frame_of(), *arrays], out, device)
    return [array.numpy().astype(np.float64) for array in out]


def sample(closures, wo, count, frame=None, features=EVERYTHING, seed=0, u=None, device=DEVICE, half=""):
    """Samples: direction [n, 3], weight [n, 3], pdf [n], lobe [n], for stratified random numbers."""
    u = stratified(count, seed) if u is None else u
    count = len(u)
    out = [wp.zeros(count, dtype=dtype, device=device) for dtype in (wp.vec3, wp.vec3, float, int)]
    table = table_of(*closures, features=features, device=device)
    arrays = [vectors(wo, count, device), vectors(u, count, device)]
    launch(kernels(features, half).sample, count, [table, frame or frame_of(), *arrays], out, device)
    return [array.numpy().astype(np.float64 if i < 3 else np.int64) for i, array in enumerate(out)]


def stratified(count, seed=0):
    """Points in [0, 1), [n, 3]: jittered in a grid of the last two dimensions, shuffled strata in the first."""
    rng = np.random.default_rng(seed)
    side = int(round(count**0.5))
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2)
    first = (rng.permutation(side * side) + rng.random(side * side)) / (side * side)
    u = np.concatenate([first[:, None], (grid + rng.random(grid.shape)) / side], 1)
    return np.minimum(u, 1 - 2.0**-24).astype(np.float32)


def toward(cosine, azimuth=0.4):
    sine = np.sqrt(1 - cosine**2)
    return np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine])


ROUGH = {
    "diffuse": (Closure(K.DIFFUSE, WHITE),),
    "layered": (Closure(K.LAYERED_DIFFUSE, WHITE, 0.4, 1.5),),
    "glossy": (Closure(K.GLOSSY, WHITE, 0.5),),
    "glossy 1": (Closure(K.GLOSSY, WHITE, 1.0),),
    "glossy 0.2": (Closure(K.GLOSSY, WHITE, 0.2),),
    "metal": (Closure(K.METAL, (0.9, 0.6, 0.3), 0.4),),
    "dielectric": (Closure(K.DIELECTRIC, WHITE, 0.3, 1.5),),
    "glass": (Closure(K.GLASS, WHITE, 0.5, 1.5),),
    "glass 0.2": (Closure(K.GLASS, WHITE, 0.2, 1.33),),
    "plastic": (Closure(K.DIELECTRIC, WHITE, 0.3, 1.5), Closure(K.LAYERED_DIFFUSE, (0.8, 0.2, 0.1), 0.3, 1.5)),
    "anisotropic": (Closure(K.GLOSSY, WHITE, 0.5, aspect=0.3, tangent=(1.0, 0.3, 0.1)),),
    "anisotropic metal": (
        Closure(K.METAL, (0.9, 0.6, 0.3), 0.6, aspect=3.0, tangent=(0.0, 1.0, 0.0), edge=(0.8, 0.9, 1.0)),
    ),
    "beckmann": (Closure(K.GLOSSY, WHITE, 0.5, multiscatter=False, distribution=1),),
    "beckmann 1": (Closure(K.GLOSSY, WHITE, 1.0, multiscatter=False, distribution=1),),
    "anisotropic beckmann": (
        Closure(K.GLOSSY, WHITE, 0.5, multiscatter=False, distribution=1, aspect=0.3, tangent=(1.0, 0.3, 0.1)),
    ),
    "beckmann glass": (Closure(K.GLASS, WHITE, 0.5, 1.5, multiscatter=False, distribution=1),),
    "tinted glass": (Closure(K.GLASS, (0.8, 0.9, 0.7), 0.5, 1.5, edge=(0.5, 2.0, 1.0), refraction=(0.9, 0.4, 0.2)),),
    "rough diffuse": (Closure(K.ROUGH_DIFFUSE, (0.8, 0.5, 1.0), 0.7),),
    "rough diffuse 1": (Closure(K.ROUGH_DIFFUSE, WHITE, 1.0),),
    "translucent": (Closure(K.TRANSLUCENT, (0.8, 0.5, 1.0)),),
    "refracting": (Closure(K.REFRACTION, WHITE, 0.4, 1.5),),
    "beckmann refracting": (Closure(K.REFRACTION, WHITE, 0.4, 1.33, distribution=1),),
    "conductor": (Closure(K.CONDUCTOR, WHITE, 0.4, color=(0.2, 0.9, 1.1), edge=(3.9, 2.4, 2.2)),),
    "sheet": (Closure(K.SHEET, WHITE, 0.5),),
    "index below 1": (Closure(K.DIELECTRIC, WHITE, 0.3, 0.7), Closure(K.LAYERED_DIFFUSE, (0.4, 0.2, 0.1), 0.3, 0.7)),
    "ashikhmin-shirley": (Closure(K.ASHIKHMIN_SHIRLEY, WHITE, 0.5),),
    "ashikhmin-shirley 1": (Closure(K.ASHIKHMIN_SHIRLEY, WHITE, 1.0),),
    "anisotropic ashikhmin-shirley": (Closure(K.ASHIKHMIN_SHIRLEY, WHITE, 0.5, aspect=0.3, tangent=(1.0, 0.3, 0.1)),),
    "sheen": (Closure(K.SHEEN, WHITE, 0.5),),
    "sheen 0.2": (Closure(K.SHEEN, WHITE, 0.2),),
    "velvet": (Closure(K.VELVET, WHITE, 0.6),),
    "toon": (Closure(K.TOON, WHITE, 0.5, mean_cosine=0.3),),
    # its cone ends where a cell of the chi-squared test does: 2 (13 / 20)^3 right angles
    "glossy toon": (Closure(K.TOON, WHITE, 0.34925, mean_cosine=0.2, distribution=1),),
    "film on metal": (
        Closure(K.METAL, (0.9, 0.6, 0.3), 0.4, edge=(0.8, 0.9, 1.0), film_thickness=500.0, film_ior=1.5),
    ),
    "film on conductor": (
        Closure(
            K.CONDUCTOR, WHITE, 0.4, color=(0.2, 0.9, 1.1), edge=(3.9, 2.4, 2.2), film_thickness=300.0, film_ior=2.0
        ),
    ),
    "film on glass": (Closure(K.GLASS, WHITE, 0.4, 1.5, film_thickness=400.0, film_ior=1.33),),
    "film on a coat": (
        Closure(K.DIELECTRIC, WHITE, 0.4, 1.5, edge=(0.5, 1.0, 2.0), film_thickness=700.0, film_ior=1.8),
    ),
    "own normals": (
        Closure(K.DIFFUSE, (0.4, 0.5, 0.6), normal=(0.36, 0.48, 0.8)),
        Closure(K.GLOSSY, (0.3, 0.2, 0.1), 0.4, normal=(-0.6, 0.0, 0.8)),
    ),
    "all": tuple(
        Closure(kind, (0.1, 0.2, 0.15), 0.4, 1.4)
        for kind in K
        if kind in EVERYTHING.kinds and kind.is_model and kind not in (K.EMISSION, K.SUBSURFACE)
    ),
}


def polar_cells(axis, power, heights, turns):
    """Bins of the sphere about `axis`, finer towards it: a function from directions to bin numbers, and quadrature.

    Returns (bin_of, directions [bins, points, 3], solid angles [bins, points]).
    """
    n = np.asarray(axis) / np.linalg.norm(axis)
    t = np.cross((0, 1, 0) if abs(n[1]) < 0.9 else (1, 0, 0), n)
    t /= np.linalg.norm(t)
    b = np.cross(n, t)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    nodes, weights = (nodes + 1) / 2, weights / 2

    def bin_of(d):
        theta = np.arctan2(np.hypot(d @ t, d @ b), d @ n)
        row = np.minimum(((theta / np.pi) ** (1 / power) * heights).astype(int), heights - 1)
        column = ((np.arctan2(d @ b, d @ t) / (2 * np.pi)) % 1.0 * turns).astype(int) % turns
        return row * turns + column

    x = (np.arange(heights)[:, None] + nodes) / heights
    phi = 2 * np.pi * (np.arange(turns)[:, None] + nodes) / turns
    theta = np.pi * x**power
    area = np.sin(theta) * np.pi * power * x ** (power - 1) * weights / heights
    theta_, phi_ = theta[:, None, :, None, None], phi[None, :, None, :, None]
    around = np.cos(phi_) * t + np.sin(phi_) * b
    directions = (np.cos(theta_) * n + np.sin(theta_) * around).reshape(heights * turns, -1, 3)
    shape = (heights, turns, len(nodes), len(nodes))
    solid = np.broadcast_to(area[:, None, :, None] * (weights * 2 * np.pi / turns)[None, None, None, :], shape)
    return bin_of, directions, solid.reshape(heights * turns, -1)


def chi_squared_deviate(observed, expected, count):
    """Chi-squared of `count` draws as a standard normal deviate (Wilson and Hilferty 1931)."""
    order = np.argsort(expected)
    pooled = np.searchsorted(np.cumsum(expected[order]), 10.0)  # bins too small for the test are pooled
    few, many = order[: pooled + 1], order[pooled + 1 :]
    e, o = np.append(expected[many], expected[few].sum()), np.append(observed[many], observed[few].sum())
    if e.sum() == 0:
        return np.inf if o.any() else 0.0
    # samples elsewhere, absorbed, or in a delta lobe
    e, o = np.append(e, count - e.sum()), np.append(o, count - o.sum())
    e, o = e[e > 1], o[e > 1]
    freedom = max(len(e) - 1, 1)
    return ((((o - e) ** 2 / e).sum() / freedom) ** (1 / 3) - (1 - 2 / (9 * freedom))) / np.sqrt(2 / (9 * freedom))


@functools.cache
def albedo(closures, cosine, entering=1, count=2**12):
    """Directional albedo [3] and its standard error, stratified."""
    estimates = [
        sample(closures, toward(cosine), count, frame_of(entering=entering), seed=seed)[1].mean(0) for seed in range(4)
    ]
    return np.mean(estimates, 0), np.std(estimates, 0).max() / 2


def hemisphere_albedo(alpha, cosine, ior=None):
    """Integral of F D G2 / (4 cos_o) over wi, in cosine and azimuth, float64; F = 1 without `ior`."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    c = ((nodes + 1) / 2)[:, None]
    phi = (np.pi * (nodes + 1) / 2)[None, :]
    s, so = np.sqrt(1 - c**2), np.sqrt(1 - cosine**2)
    h = np.stack(np.broadcast_arrays(s * np.cos(phi) + so, s * np.sin(phi), c + cosine))
    cos2 = h[2] ** 2 / (h**2).sum(0)
    d = alpha**2 / (np.pi * (cos2 * (alpha**2 - 1) + 1) ** 2)
    smith = [(np.sqrt(1 + alpha**2 * (1 / x**2 - 1)) - 1) / 2 for x in (c, cosine)]
    f = d / (1 + smith[0] + smith[1]) / (4 * cosine)
    if ior is not None:
        f = f * fresnel(np.linalg.norm(h, axis=0) / 2, ior)
    return (f * weights[:, None] / 2 * weights[None, :] * np.pi).sum()  # both halves of the azimuth


def fresnel(cosine, eta):
    """Fresnel's equations as in a textbook; 1 at total internal reflection."""
    sine2 = (1 - cosine**2) / eta**2
    t = np.sqrt(np.maximum(1 - sine2, 0))
    s, p = (cosine - eta * t) / (cosine + eta * t + 1e-300), (eta * cosine - t) / (eta * cosine + t + 1e-300)
    return np.where(sine2 >= 1, 1.0, (s * s + p * p) / 2)
