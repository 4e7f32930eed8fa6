#!/usr/bin/env python3
"""Computes raybatch_addon/core/shading/albedo.npz, the tables that `shading/albedo.py` describes.

Gauss-Legendre and midpoint quadrature in float64 over the visible microfacet normals: in the
parameters of their sampling the integrand is smooth but for the horizon and the critical angle. The
error of the quadrature is below 3e-4. Takes about two minutes; the file is part of the repository.
"""

import math
from pathlib import Path

import numpy as np

ROUGHNESS_COUNT = 32
COSINE_COUNT = 32
IOR_COUNT = 32  # of ior >= 1
POINT_COUNT = 64  # quadrature points in each of two directions
ALPHA_LEAST = 1e-6  # stands for the limit at roughness 0
IOR_LARGEST = 1e3  # the end of the axis (`IOR_RANGE` of materials.py)


def slope(alpha, cosine):
    """sqrt(cos^2 + alpha^2 sin^2)."""
    return np.sqrt(cosine**2 + alpha**2 * (1 - cosine**2))


def shadowing(alpha, cos_o, cos_i):
    """G2 / G1(wo), 0 below the horizon."""
    c = np.maximum(cos_i, 1e-300)
    return np.where(cos_i > 0, c * (cos_o + slope(alpha, cos_o)) / (c * slope(alpha, cos_o) + cos_o * slope(alpha, c)), 0)


def fresnel(cosine, eta):
    """Unpolarised reflectance of a dielectric."""
    m = eta**2 - 1
    g = np.sqrt(np.maximum(m + cosine**2, 0))
    cos_t = g / eta
    s = (cosine - eta * cos_t) / np.maximum(cosine + eta * cos_t, 1e-300)
    p = (eta * cosine - cos_t) / np.maximum(eta * cosine + cos_t, 1e-300)
    return np.where(m + cosine**2 <= 0, 1.0, (s**2 + p**2) / 2)


def visible_normals(alpha, cos_o):
    """Normals h (x, y, z) seen from wo = (sin, 0, cos), with weights that sum to 1; shapes [n, n]."""
    nodes, weights = np.polynomial.legendre.leggauss(POINT_COUNT)
    u = (nodes[:, None] + 1) / 2
    phi = np.pi * (np.arange(POINT_COUNT) + 0.5) / POINT_COUNT  # half a turn: the other half mirrors it
    stretched = np.array([alpha * math.sqrt(1 - cos_o**2), cos_o])
    stretched /= np.linalg.norm(stretched)
    height = (1 - u) * (1 + stretched[1])
    radius = np.sqrt(np.maximum(1 - (height - stretched[1]) ** 2, 0))
    h = np.stack(np.broadcast_arrays(alpha * (radius * np.cos(phi) + stretched[0]), alpha * radius * np.sin(phi), height))
    weight = np.broadcast_to(weights[:, None] / 2 / POINT_COUNT, h.shape[1:])
    return h / np.linalg.norm(h, axis=0), weight


def reflected_and_total(alpha, cos_o, etas):
    """Directional albedo of GGX: of F = 1, of dielectric reflection, and of reflection plus refraction (by eta)."""
    h, weight = visible_normals(alpha, cos_o)
    c = math.sqrt(1 - cos_o**2) * h[0] + cos_o * h[2]
    mirror = weight * shadowing(alpha, cos_o, 2 * c * h[2] - cos_o)
    reflected, total = [], []
    for eta in etas:
        f = fresnel(c, eta)
        g = np.sqrt(np.maximum(eta**2 - 1 + c**2, 0))
        cos_i = -((c - g) * h[2] - cos_o) / eta
        reflected.append((mirror * f).sum())
        total.append(reflected[-1] + (weight * (1 - f) * shadowing(alpha, cos_o, cos_i)).sum())
    return mirror.sum(), np.array(reflected), np.array(total)


def average(values_of_cosine):
    """2 integral of f(mu) mu over [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(48)
    mu = ((nodes + 1) / 2) ** 2  # finer where the cosine is small
    jacobian = nodes + 1
    return sum(2 * m * v * w * j / 2 for m, v, w, j in zip(mu, (values_of_cosine(m) for m in mu), weights, jacobian))


def quantised(values):
    """[0, 1] as uint16."""
    return np.rint(np.clip(values, 0, 1) * 65535).astype(np.uint16)


def quantised_difference(values):
    """[-1, 1] as int16; 0 stays 0."""
    return np.rint(np.clip(values, -1, 1) * 32767).astype(np.int16)


def refined(values):
    """Linear interpolation at the nodes and midway between them, along every axis."""
    for axis in range(values.ndim):
        v = np.moveaxis(values, axis, 0)
        fine = np.empty((2 * len(v) - 1, *v.shape[1:]))
        fine[::2], fine[1::2] = v, (v[:-1] + v[1:]) / 2
        values = np.moveaxis(fine, 0, axis)
    return values


def raised(truth):
    """Every second entry of `truth`, raised so that interpolation between them is below it nowhere.

    A table that is too high darkens by its error; one that is too low makes energy, bounce by bounce.
    """
    nodes = truth[(slice(None, None, 2),) * truth.ndim]
    lack = np.maximum(truth - refined(nodes), 0)
    for axis in range(lack.ndim):  # the largest of all cells around a node
        v = np.pad(np.moveaxis(lack, axis, 0), [(1, 1)] + [(0, 0)] * (lack.ndim - 1))
        lack = np.moveaxis(np.maximum(np.maximum(v[:-2:2], v[1:-1:2]), v[2::2]), 0, axis)
    return np.minimum(nodes + lack, 1)


def main():
    """Computes and writes the file."""
    axis = np.linspace(-1, 1, 4 * IOR_COUNT - 3)  # sign(l) |l|^(1/4), l = log(eta) / log(1000)
    etas = IOR_LARGEST ** (np.sign(axis) * axis**4)
    etas[2 * IOR_COUNT - 2] = 1 + 1e-7  # the limit at 1: facets without effect but for their shadows
    coats = etas[2 * IOR_COUNT - 2 :].copy()
    coats[0] = 1

    # all at twice the resolution of the tables
    shape = (2 * ROUGHNESS_COUNT - 1, 2 * COSINE_COUNT - 1)
    reflection = np.zeros(shape)
    glass = np.zeros((len(etas), *shape))
    coat = np.zeros((len(coats), *shape))
    single = np.zeros((len(coats), *shape))
    reflection_average = np.zeros(ROUGHNESS_COUNT)
    for i, roughness in enumerate(np.linspace(0, 1, shape[0])):
        alpha = max(roughness**2, ALPHA_LEAST)
        for j, u in enumerate(np.linspace(0, 1, shape[1])):
            cosine = u * u * alpha / (1 + alpha - u * u)
            cosine = min(max(cosine, 1e-3 * ALPHA_LEAST), 1)
            reflection[i, j], reflected, glass[:, i, j] = reflected_and_total(alpha, cosine, etas)
            coat[:, i, j] = np.append(0.0, reflected[2 * IOR_COUNT - 1 :])
            single[:, i, j] = fresnel(slope(alpha, cosine), coats)
        if i % 2 == 0:
            reflection_average[i // 2] = average(lambda mu: reflected_and_total(alpha, mu, ())[0])
    reflection = raised(reflection)
    # what the table of all light makes of it
    difference = raised(coat / refined(reflection) - single)
    difference[0] = 0

    np.savez_compressed(
        Path(__file__).parents[1] / "raybatch_addon/core/shading/albedo.npz",
        reflection=quantised(reflection),
        reflection_average=quantised(reflection_average),
        coat=quantised_difference(difference),
        fresnel_average=quantised(np.array([average(lambda mu: fresnel(mu, eta)) for eta in coats[::2]])),
        glass=quantised(raised(glass)),
    )


if __name__ == "__main__":
    main()
