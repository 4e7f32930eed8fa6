"""Glass in float64: Fresnel's equations, slabs, and light through a ball of facets."""

from __future__ import annotations

import numpy as np

from raybatch_addon.core.scene.description import Mesh

LEAST = 1e-5  # rays that carry less are followed no further


def reflectance(cosine, eta: float) -> np.ndarray:
    """Of unpolarised light at a smooth dielectric (Born and Wolf, section 1.5), with total reflection; float64, shape of `cosine`.

    `eta`: index of refraction behind the surface, relative to that before it. `cosine`: of the angle of incidence, 0 to 1."""
    cosine = np.asarray(cosine, np.float64)
    square = 1 - (1 - cosine**2) / eta**2
    inside = np.sqrt(np.maximum(square, 0))
    s = (cosine - eta * inside) / (cosine + eta * inside)
    p = (eta * cosine - inside) / (eta * cosine + inside)
    return np.where(square > 0, (s * s + p * p) / 2, 1.0)


def plate_transmission(cosine, eta: float) -> np.ndarray:
    """Of a plate: (1 - R) / (1 + R), all reflections within it counted; shape of `cosine`."""
    r = reflectance(cosine, eta)
    return (1 - r) / (1 + r)


def slab_albedo(eta: float) -> float:
    """Share of diffuse light that a plate reflects: 1 minus the integral of 2 c (1 - R) / (1 + R) over the cosine c from 0 to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    # c = x^2, so that what is steep at grazing angles is smooth
    x = (nodes + 1) / 2
    return float(1 - np.sum(weights / 2 * 2 * x * 2 * x**2 * plate_transmission(x**2, eta)))


def adding(sides: list[tuple[float, float]]) -> tuple[float, float]:
    """Reflectance and transmittance of interfaces (reflectance, transmittance), alike from either side, one behind the other."""
    reflected, back, passed = 0.0, 0.0, 1.0  # seen from the front; from behind; through (alike both ways)
    for r, t in sides:
        between = 1 / (1 - back * r)
        reflected, back, passed = reflected + passed * r * passed * between, r + t * back * t * between, passed * t * between
    return reflected, passed


def ball_caustic(ball: Mesh, centre: tuple[float, float, float], ior: float, lamp_half: float, lamp_height: float, cells: int = 48) -> tuple[float, float, float]:
    """Radiance of a white floor at the origin, facing +z, under a glass mesh and a square lamp of radiance 1 above it, parallel to the floor;
    the standard error, from 8 grids of directions with a random place in every cell; and what rays that were not followed carried."""
    corners = ball.positions.astype(np.float64)[ball.triangles] + centre
    grids = [_caustic_mean(corners, ior, lamp_half, lamp_height, cells, np.random.default_rng(seed)) for seed in range(8)]
    means, left_out = np.array(grids).T
    return float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means))), float(left_out.mean())


def _caustic_mean(corners: np.ndarray, ior: float, half: float, height: float, cells: int, random: np.random.Generator) -> tuple[float, float]:
    u, v = ((np.stack(np.meshgrid(np.arange(cells), np.arange(cells))).reshape(2, -1) + random.random((2, cells * cells))) / cells)
    radius, angle = np.sqrt(u), 2 * np.pi * v
    d = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - u)], -1)
    o, weight, inside = np.zeros_like(d), np.full(len(d), 1 / len(d)), np.zeros(len(d), bool)
    skipped = np.full(len(d), -1)  # the facet that a ray comes from
    least, total, left_out = LEAST / len(d), 0.0, 0.0
    while len(d):
        t, facet = _nearest(o, d, corners, skipped)
        with np.errstate(divide="ignore", invalid="ignore"):
            up = (height - o[:, 2]) / d[:, 2]
            lit = (up > 0) & (up < t) & (np.abs(o[:, :2] + up[:, None] * d[:, :2]).max(1) <= half)
        total += weight[lit].sum()
        on = np.isfinite(t) & ~lit
        o, d, weight, inside, facet = o[on] + t[on, None] * d[on], d[on], weight[on], inside[on], facet[on]
        normal = np.cross(corners[facet, 1] - corners[facet, 0], corners[facet, 2] - corners[facet, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        normal[inside] *= -1
        cosine = -(d * normal).sum(1)
        eta = np.where(inside, 1 / ior, ior)
        r = np.where(inside, reflectance(np.clip(cosine, 0, 1), 1 / ior), reflectance(np.clip(cosine, 0, 1), ior))
        mirrored = d + 2 * cosine[:, None] * normal
        bent = d / eta[:, None] + (cosine / eta - np.sqrt(np.maximum(1 - (1 - cosine**2) / eta**2, 0)))[:, None] * normal
        o, d = np.concatenate([o, o]), np.concatenate([mirrored, bent])
        weight, inside, skipped = np.concatenate([weight * r, weight * (1 - r)]), np.concatenate([inside, ~inside]), np.concatenate([facet, facet])
        kept = weight > least
        left_out += weight[~kept].sum()
        o, d, weight, inside, skipped = o[kept], d[kept], weight[kept], inside[kept], skipped[kept]
    return total, left_out


def _nearest(o: np.ndarray, d: np.ndarray, corners: np.ndarray, skipped: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the nearest facet, infinite where there is none, and which it is (Moeller and Trumbore 1997)."""
    best, which = np.full(len(d), np.inf), np.zeros(len(d), int)
    for number, (a, b, c) in enumerate(corners):
        e, f = b - a, c - a
        p = np.cross(d, f)
        volume = p @ e
        with np.errstate(divide="ignore", invalid="ignore"):
            s = o - a
            u = (s * p).sum(1) / volume
            q = np.cross(s, e)
            v = (d * q).sum(1) / volume
            t = (q @ f) / volume
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < best) & (skipped != number)
        best[met], which[met] = t[met], number
    return best, which
