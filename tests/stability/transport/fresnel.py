"""Glass in float64: Fresnel's equations, slabs, and light through a ball of facets."""

from __future__ import annotations

import numpy as np

from raybatch_addon.core.scene.description import Mesh

LEAST = 1e-5  # rays that carry less are not followed


def reflectance(cosine, eta) -> np.ndarray:
    """Reflectance of unpolarised light at a smooth dielectric, with total reflection; float64, shape of `cosine`.

    Born and Wolf, section 1.5. `eta`: index of refraction behind the surface, relative to that before it. `cosine`:
    cosine of the angle of incidence, 0 to 1.
    """
    cosine = np.asarray(cosine, np.float64)
    square = 1 - (1 - cosine**2) / eta**2
    inside = np.sqrt(np.maximum(square, 0))
    s = (cosine - eta * inside) / (cosine + eta * inside)
    p = (eta * cosine - inside) / (eta * cosine + inside)
    return np.where(square > 0, (s * s + p * p) / 2, 1.0)


def plate_transmission(cosine, eta: float) -> np.ndarray:
    """Transmittance of a plate: (1 - R) / (1 + R), all reflections within it counted; shape of `cosine`."""
    r = reflectance(cosine, eta)
    return (1 - r) / (1 + r)


def slab_albedo(eta: float) -> float:
    """Share of diffuse light that a plate reflects.

    It is 1 minus the integral of 2 c (1 - R) / (1 + R) over the cosine c from 0 to 1.
    """
    nodes, weights = np.polynomial.legendre.leggauss(400)
    # c = x^2, so that the steep part at grazing angles becomes smooth
    x = (nodes + 1) / 2
    return float(1 - np.sum(weights / 2 * 2 * x * 2 * x**2 * plate_transmission(x**2, eta)))


def adding(sides: list[tuple[float, float]]) -> tuple[float, float]:
    """Reflectance and transmittance of interfaces one behind the other.

    `sides` holds (reflectance, transmittance) of each, the same from either side.
    """
    reflected, back, passed = 0.0, 0.0, 1.0  # seen from the front; from behind; through (the same both ways)
    for r, t in sides:
        between = 1 / (1 - back * r)
        reflected, back, passed = (
            reflected + passed * r * passed * between,
            r + t * back * t * between,
            passed * t * between,
        )
    return reflected, passed


def ball_caustic(
    ball: Mesh, centre: tuple[float, float, float], ior: float, lamp_half: float, lamp_height: float, cells: int = 24
) -> tuple[float, float, float]:
    """Radiance of a white floor at the origin, facing +z, under a glass mesh and a square lamp of radiance 1.

    The lamp is above the mesh, parallel to the floor. Returns the radiance; its standard error, from 32 grids of
    directions with a random point in every cell; and the light of rays that were not followed.
    """
    grids = 32
    corners = ball.positions.astype(np.float64)[ball.triangles] + centre
    first = np.tile(np.stack(np.meshgrid(np.arange(cells), np.arange(cells))).reshape(2, -1), grids)
    u, v = (first + np.random.default_rng(0).random(first.shape)) / cells
    radius, angle = np.sqrt(u), 2 * np.pi * v
    d = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - u)], -1)
    share = 1 / cells**2
    brought, left_out = _followed(d, share, LEAST * share, corners, ior, lamp_half, lamp_height)
    means = brought.reshape(grids, -1).sum(1)
    return float(means.mean()), float(means.std(ddof=1) / np.sqrt(grids)), left_out / grids


def _followed(
    d: np.ndarray, share: float, least: float, corners: np.ndarray, ior: float, half: float, height: float
) -> tuple[np.ndarray, float]:
    """Light of the lamp along each of the directions `d` to the origin, times `share`, through convex glass.

    The glass has these `corners`. The second result is the light of all rays that were not followed, as they carried
    less than `least`.
    """
    o, weight, inside, begun = np.zeros_like(d), np.full(len(d), share), np.zeros(len(d), bool), np.arange(len(d))
    skipped = np.full(len(d), -1)  # the facet that a ray starts from
    brought, left_out = np.zeros(len(d)), 0.0
    while len(d):
        t, facet = _nearest(o, d, corners, skipped)
        with np.errstate(divide="ignore", invalid="ignore"):
            up = (height - o[:, 2]) / d[:, 2]
            lit = (up > 0) & (up < t) & (np.abs(o[:, :2] + up[:, None] * d[:, :2]).max(1) <= half)
        np.add.at(brought, begun[lit], weight[lit])
        on = np.isfinite(t) & ~lit
        o, d, weight, inside, facet, begun = (
            o[on] + t[on, None] * d[on],
            d[on],
            weight[on],
            inside[on],
            facet[on],
            begun[on],
        )
        normal = np.cross(corners[facet, 1] - corners[facet, 0], corners[facet, 2] - corners[facet, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        normal[inside] *= -1
        cosine = -(d * normal).sum(1)
        eta = np.where(inside, 1 / ior, ior)
        r = reflectance(np.clip(cosine, 0, 1), eta)
        mirrored = d + 2 * cosine[:, None] * normal
        bent = (
            d / eta[:, None] + (cosine / eta - np.sqrt(np.maximum(1 - (1 - cosine**2) / eta**2, 0)))[:, None] * normal
        )
        o, d, begun, skipped = (
            np.tile(o, (2, 1)),
            np.concatenate([mirrored, bent]),
            np.tile(begun, 2),
            np.tile(facet, 2),
        )
        weight, inside = np.concatenate([weight * r, weight * (1 - r)]), np.concatenate([inside, ~inside])
        kept = weight > least
        left_out += float(weight[~kept].sum())
        o, d, weight, inside, skipped, begun = o[kept], d[kept], weight[kept], inside[kept], skipped[kept], begun[kept]
    return brought, left_out


def _nearest(o: np.ndarray, d: np.ndarray, corners: np.ndarray, skipped: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of the nearest facet, infinite if there is none, and its number (Moeller and Trumbore 1997)."""
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
