#!/usr/bin/env python3
"""Computes raybatch_addon/core/shading/bsdf/albedo.npz, the tables that `shading/bsdf/albedo.py` describes.

Gauss-Legendre and midpoint quadrature in float64 over the visible microfacet normals: in the
parameters of their sampling the integrand is smooth but for the horizon and the critical angle. The
error of the quadrature is below 3e-4. Takes about ten minutes of a core; the file is part of the repository.
"""

import itertools
import math
from multiprocessing import Pool
from pathlib import Path

import numpy as np

ROUGHNESS_COUNT = 32
COSINE_COUNT = 32
IOR_COUNT = 32  # of ior >= 1
# Points of a table's cell at which the truth is known: the critical angle is a kink in cosine and index
PARTS_ROUGHNESS, PARTS = 2, 4
POINT_COUNT = 64  # quadrature points in each of two directions
ALPHA_LEAST = 1e-6  # stands for the limit at roughness 0
IOR_LARGEST = 1e3  # the end of the axis (`IOR_RANGE` of bsdf/materials.py)


def slope(alpha, cosine):
    """sqrt(cos^2 + alpha^2 sin^2)."""
    return np.sqrt(cosine**2 + alpha**2 * (1 - cosine**2))


def shadowing(alpha, cos_o, cos_i):
    """G2 / G1(wo), 0 below the horizon."""
    c = np.maximum(cos_i, 1e-300)
    return np.where(
        cos_i > 0, c * (cos_o + slope(alpha, cos_o)) / (c * slope(alpha, cos_o) + cos_o * slope(alpha, c)), 0
    )


def fresnel(cosine, eta):
    """Unpolarised reflectance of a dielectric, without a difference of nearly equal numbers (as
    shading/bsdf/ggx.py).
    """
    return fresnel_and_root(cosine, eta)[0]


def fresnel_and_root(cosine, eta):
    """The reflectance, and eta times the cosine behind the surface."""
    m = (eta - 1) * (eta + 1)
    square = m + cosine * cosine
    g = np.sqrt(np.maximum(square, 0))
    both = np.maximum(g + cosine, 1e-300)
    s = m / (both * both)
    p = s * (cosine * both - 1) / (cosine * m / both + 1)
    return np.where(m == 0, 0.0, np.where(square <= 0, 1.0, np.minimum((s * s + p * p) / 2, 1))), g


def visible_normals(alpha, cos_o):
    """Normals h (x, y, z) seen from wo = (sin, 0, cos), with weights that sum to 1; shapes [n, n]."""
    nodes, weights = np.polynomial.legendre.leggauss(POINT_COUNT)
    u = (nodes[:, None] + 1) / 2
    phi = np.pi * (np.arange(POINT_COUNT) + 0.5) / POINT_COUNT  # half a turn: the other half mirrors it
    stretched = np.array([alpha * math.sqrt(1 - cos_o**2), cos_o])
    stretched /= np.linalg.norm(stretched)
    height = (1 - u) * (1 + stretched[1])
    radius = np.sqrt(np.maximum(1 - (height - stretched[1]) ** 2, 0))
    h = np.stack(
        np.broadcast_arrays(alpha * (radius * np.cos(phi) + stretched[0]), alpha * radius * np.sin(phi), height)
    )
    weight = np.broadcast_to(weights[:, None] / 2 / POINT_COUNT, h.shape[1:])
    return h / np.linalg.norm(h, axis=0), weight


def reflected_and_total(alpha, cos_o, etas):
    """Directional albedo of GGX: of F = 1, of dielectric reflection, and of reflection plus refraction (by eta)."""
    h, weight = visible_normals(alpha, cos_o)
    c = math.sqrt(1 - cos_o**2) * h[0] + cos_o * h[2]
    mirror = weight * shadowing(alpha, cos_o, 2 * c * h[2] - cos_o)
    reflected, total = [], []
    for eta in etas:
        f, g = fresnel_and_root(c, eta)
        cos_i = ((eta - 1) * (eta + 1) / (g + c) * h[2] + cos_o) / eta
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
    """[0, 1] as uint16; upwards, as a table that is too low makes energy."""
    return np.ceil(np.clip(values, 0, 1) * 65535 - 1e-6).astype(np.uint16)


def quantised_difference(values):
    """[-1, 1] as int16, upwards; 0 stays 0."""
    return np.ceil(np.clip(values, -1, 1) * 32767 - 1e-6).astype(np.int16)


def refined(values, parts):
    """Linear interpolation at `parts[i]` places of every cell along axis i."""
    for axis, count in enumerate(parts):
        v = np.moveaxis(values, axis, 0)
        fine = np.empty((count * (len(v) - 1) + 1, *v.shape[1:]))
        for j in range(count):
            fine[j:-1:count] = v[:-1] + (v[1:] - v[:-1]) * (j / count)
        fine[-1] = v[-1]
        values = np.moveaxis(fine, 0, axis)
    return values


def raised(truth, parts):
    """Entries of `truth` at the nodes of a table, raised so that interpolation between them is below it nowhere that it
    is known.

    A table that is too high darkens by its error; one that is too low makes energy, bounce by bounce.
    """
    nodes = truth[tuple(slice(None, None, count) for count in parts)]
    lack = np.maximum(truth - refined(nodes, parts), 0)
    for axis, count in enumerate(parts):  # the largest of all cells around a node
        v = np.moveaxis(lack, axis, 0)
        padded = np.pad(v, [(count - 1, count - 1)] + [(0, 0)] * (lack.ndim - 1))
        largest = np.max([padded[j : j + len(v) : count] for j in range(2 * count - 1)], axis=0)
        lack = np.moveaxis(largest, 0, axis)
    return nodes + lack


def without_a_coat(table, truth, parts):
    """`table` with 0 at the index 1, which its next entries make up for."""
    table[0] = 0
    for j in range(1, parts[0]):
        lack = truth[j] - refined(table[1], parts[1:]) * (j / parts[0])
        # as differences of the next entries, all cells around a node
        missing = raised(np.maximum(lack, 0), parts[1:]) * (parts[0] / j)
        table[1] += np.where(missing > 0, missing, 0)
    return table


def indices():
    """Indices of refraction at which the truth is known: `PARTS` in each cell."""
    axis = np.linspace(-1, 1, 2 * PARTS * (IOR_COUNT - 1) + 1)  # sign(l) |l|^(1/4), l = log(eta) / log(1000)
    etas = IOR_LARGEST ** (np.sign(axis) * axis**4)
    etas[PARTS * (IOR_COUNT - 1)] = 1 + 1e-7  # the limit at 1: facets without effect but for their shadows
    return etas


def known(place):
    """The truth at (roughness, cosine coordinate): of all light, of reflection by index, of all of glass by index, of
    one facet by index > 1.
    """
    roughness, u = place
    alpha = max(roughness**2, ALPHA_LEAST)
    cosine = u * u * alpha / (1 + alpha - u * u)
    cosine = min(max(cosine, 1e-3 * ALPHA_LEAST), 1)
    etas = indices()
    return *reflected_and_total(alpha, cosine, etas), fresnel(slope(alpha, cosine), etas)


def main():
    """Computes and writes the file."""
    etas = indices()
    one = PARTS * (IOR_COUNT - 1)  # where the index is 1
    parts = (PARTS, PARTS_ROUGHNESS, PARTS)
    roughnesses = np.linspace(0, 1, PARTS_ROUGHNESS * (ROUGHNESS_COUNT - 1) + 1)
    coordinates = np.linspace(0, 1, PARTS * (COSINE_COUNT - 1) + 1)
    with Pool() as pool:
        found = pool.map(known, itertools.product(roughnesses, coordinates), chunksize=64)
    shape = (len(roughnesses), len(coordinates))
    all_light, reflected, total, single = (
        np.moveaxis(np.array(each).reshape(*shape, -1), 2, 0) for each in zip(*found)
    )
    reflected[one] = single[one] = 0  # a coat of index 1 is none
    reflection = np.minimum(raised(all_light[0], parts[1:]), 1)
    # what the table of all light makes of it
    difference = (reflected / refined(reflection, parts[1:]) - single)[one:]

    reflection_average = [
        average(lambda mu: reflected_and_total(max(roughness**2, ALPHA_LEAST), mu, ())[0])
        for roughness in roughnesses[::PARTS_ROUGHNESS]
    ]
    coats = [1.0, *etas[one + PARTS :: PARTS]]
    np.savez_compressed(
        Path(__file__).parents[2] / "raybatch_addon/core/shading/bsdf/albedo.npz",
        reflection=quantised(reflection),
        reflection_average=quantised(np.array(reflection_average)),
        coat=quantised_difference(without_a_coat(raised(difference, parts), difference, parts)),
        fresnel_average=quantised(np.array([average(lambda mu: fresnel(mu, eta)) for eta in coats])),
        glass=quantised(raised(total, parts)),
    )


if __name__ == "__main__":
    main()
