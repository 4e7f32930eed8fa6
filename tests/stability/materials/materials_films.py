"""Thin films: none at 0 nm, furnaces of glass with a film, and the colours of films."""

from __future__ import annotations

import itertools
import math

import numpy as np

from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.shading.bsdf.color_matching import WAVELENGTHS, XYZ_TO_REC709, matching_functions
from tests.core.shading.bsdf import closure_probe as probe
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.materials.closures import STATISTICS, WHITE, albedo, sample
from tests.stability.uniform import UNIT_ROUNDOFF


@case(
    "a film of 0 nm is none",
    "materials",
    "Films of 0, 1e-6 and 0.1 nm on metal, conductor, coat and glass: the same samples as without, to the bit.",
    "The same operations: exact.",
    traces=False,
    quick=True,
)
def no_film(bench: Bench) -> Outcome:
    """Sweep over kinds and thicknesses."""
    sweep = Sweep()
    for kind, roughness, entering in itertools.product(
        (K.METAL, K.CONDUCTOR, K.DIELECTRIC, K.GLASS), (0.0, 0.3), (1, 0)
    ):
        values = dict(roughness=roughness, ior=1.5, color=(0.9, 0.5, 0.3), edge=(1.0, 0.8, 2.0))
        bare = sample(bench, (Closure(kind, WHITE, **values),), probe.toward(0.4), 1024, entering)
        for thickness in (1e-6, 0.1):
            filmed = (Closure(kind, WHITE, **values, film_thickness=thickness, film_ior=1.7),)
            filmed = sample(bench, filmed, probe.toward(0.4), 1024, entering)
            unlike = sum(int((a != b).sum()) for a, b in zip(bare, filmed))
            sweep.add(
                unlike,
                0,
                0,
                f"{kind.name.lower()}, roughness {roughness:g}, thickness {thickness:g}, entering {entering}",
            )
    return sweep.outcome()


@case(
    "furnace: glass with a film",
    "materials",
    "Glass refracts the light that its film does not reflect: all light comes back or goes on, at thicknesses of 0.2 "
    "to 1e6 nm and indices of 0.5 to 3, from both sides.",
    f"{STATISTICS}, and 16 roundings. Rough glass gets back what bare glass would lose: 0.03 of that is not known, "
    "and facets hide what they reflect more than what they refract, where a film changes the shares: 0.09 at most at "
    "this roughness.",
    traces=False,
)
def furnace_film(bench: Bench) -> Outcome:
    """Sweep over thicknesses, indices, roughnesses, sides and angles."""
    sweep = Sweep()
    for thickness, index, roughness, entering in itertools.product(
        (0.2, 30.0, 400.0, 5e3, 1e6), (0.5, 1.33, 3.0), (0.0, 0.4), (1, 0)
    ):
        for cosine in (1.0, 0.6, 0.2):
            closure = Closure(K.GLASS, WHITE, roughness, 1.5, film_thickness=thickness, film_ior=index)
            measured, spread = albedo(bench, (closure,), cosine, entering, 8)
            note = (
                f"{thickness:g} nm of index {index:g}, roughness {roughness:g}, cosine {cosine:g}, entering {entering}"
            )
            sweep.add(measured, 1.0, (0.12 if roughness > 0 else 0.0) + spread + 16 * UNIT_ROUNDOFF, note)
    return sweep.outcome()


def _exact_film(thickness: float, index: float, substrate: complex, cosine: float) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance by channel, from Airy's sum at each wavelength, and the error that the film's series may have.

    The series has four terms, from a table of 512 entries.
    """
    fine = np.arange(WAVELENGTHS[0], WAVELENGTHS[-1], 0.25)
    channels = matching_functions() @ np.array(XYZ_TO_REC709).T
    sensitivity = np.stack([np.interp(fine, WAVELENGTHS, channel) for channel in channels.T])
    norm = sensitivity.sum(1)

    def inside(n: complex) -> complex:
        return np.sqrt(1 - (1 - cosine**2) / n**2 + 0j)

    below, film = inside(substrate), inside(index)
    phase = np.exp(4j * np.pi * index * thickness * film / fine)
    result, bound = np.zeros(3), np.zeros(3)
    spacing = 6e4 / (2 * math.pi) / 511
    absolute = np.abs(sensitivity).sum(1) / np.abs(norm)
    for p in (0, 1):

        def amplitude(n1, c1, n2, c2, parallel=p):
            return (n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2) if parallel else (n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2)

        upper, lower = amplitude(1, cosine, index, film), amplitude(index, film, substrate, below)
        r = np.abs((upper + lower * phase) / (1 + upper * lower * phase)) ** 2
        result += (sensitivity @ r) / norm / 2
        r12, r23 = abs(upper) ** 2, abs(lower) ** 2
        root = math.sqrt(r12 * r23)
        term = abs((1 - r12) ** 2 * r23 / (1 - r12 * r23) - (1 - r12))
        left_out = 2 * term * root**4 / (1 - root)
        interpolated = sum(2 * term * root**m * (spacing * m * 2 * math.pi / 380) ** 2 / 8 for m in (1, 2, 3))
        bound += absolute * (left_out + interpolated) / 2
    return result, bound


@case(
    "colours of films",
    "materials",
    "Smooth films of 50 to 2,000 nm on a coat and on conductors: each channel's reflectance, from Airy's sum of all "
    "reflections at every quarter of a nanometre, times the channel's sensitivity, in complex float64.",
    "The terms of the series that are left out, and linear interpolation of those taken, both bounded for each film "
    "(by the transform's second derivative), and 1e-4.",
    traces=False,
)
def film_colors(bench: Bench) -> Outcome:
    """Sweep over substrates, thicknesses, indices and angles."""
    sweep = Sweep()
    for thickness, index, cosine in itertools.product(
        (50.0, 180.0, 400.0, 900.0, 2e3), (1.2, 1.33, 1.8), (1.0, 0.7, 0.3)
    ):
        film = dict(film_thickness=thickness, film_ior=index)
        for name, closure, substrate in (
            ("coat", Closure(K.DIELECTRIC, WHITE, 0.0, 1.5, multiscatter=False, **film), 1.5),
            ("copper", Closure(K.CONDUCTOR, WHITE, 0.0, color=(0.27,) * 3, edge=(3.4,) * 3, **film), 0.27 + 3.4j),
            ("silicon", Closure(K.CONDUCTOR, WHITE, 0.0, color=(3.9,) * 3, edge=(0.02,) * 3, **film), 3.9 + 0.02j),
        ):
            expected, bound = _exact_film(thickness, index, substrate, cosine)
            weight = sample(bench, (closure,), probe.toward(cosine), 16)[1].mean(0)
            for channel in range(3):
                note = f"{name}, {thickness:g} nm of index {index:g}, cosine {cosine:g}, channel {channel}"
                sweep.add(weight[channel], float(np.clip(expected[channel], 0, 1)), bound[channel] + 1e-4, note)
    return sweep.outcome()
