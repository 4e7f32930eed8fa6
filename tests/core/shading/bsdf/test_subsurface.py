"""Media below surfaces and the sampling of walks, against quadrature."""

import numpy as np
import pytest

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.op import as_python
from raybatch_addon.core.programs.ops.closures.soft import SubsurfaceMethod
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.shading.bsdf.subsurface import (
    diffusion_length,
    dipole_albedo,
    fitted_albedo,
    guide_cosine,
    guide_density,
    guide_logarithm,
    medium_albedo,
    phase_cosine,
    phase_density,
)

NODES, WEIGHTS = np.polynomial.legendre.leggauss(400)
NONE = (0.0, 0.0, 0.0)


def on_host(function):
    """The Python body of a Warp function of numbers."""
    body = as_python(function)
    return lambda *numbers: body(*(x if isinstance(x, tuple) else float(x) for x in numbers))


def closures_of(color, radius, g=0.0, method=SubsurfaceMethod.RANDOM_WALK, ior=1.4):
    builder = ProgramBuilder()
    builder.closure("subsurface", (0.5, 0.5, 0.5), color, radius, g, method, 0.3, ior, NONE)
    return builder.constant_closures()


@pytest.mark.parametrize("g", [-0.9, -0.3, 0.0, 5e-4, 0.5, 0.95])
def test_phase_functions_are_densities_and_are_sampled(g):
    density, cosine = on_host(phase_density), on_host(phase_cosine)
    values = 2 * np.pi * np.array([density(g, c) for c in NODES])
    assert values @ WEIGHTS == pytest.approx(1, rel=1e-3)
    assert (values * NODES) @ WEIGHTS == pytest.approx(g, abs=2e-3)
    drawn = np.array([cosine(g, (i + 0.5) / 4000) for i in range(4000)])
    assert drawn.mean() == pytest.approx(g, abs=2e-3) and np.abs(drawn).max() <= 1


@pytest.mark.parametrize("albedo", [0.2, 0.7, 0.99, 0.9999])
def test_guides_are_densities_and_are_sampled(albedo):
    diffusion = on_host(diffusion_length)((0.2, albedo, 0.2))
    assert diffusion > 1
    logarithm = on_host(guide_logarithm)(diffusion)
    density, cosine = on_host(guide_density), on_host(guide_cosine)
    drawn = np.array([cosine(diffusion, logarithm, (i + 0.5) / 4000) for i in range(4000)])
    assert np.abs(drawn).max() <= 1
    for edge in (-0.5, 0.3, 0.8):  # shares below an edge
        x = (NODES + 1) / 2 * (edge + 1) - 1
        share = 2 * np.pi * (np.array([density(diffusion, logarithm, c) for c in x]) @ WEIGHTS) * (edge + 1) / 2
        assert share == pytest.approx((drawn < edge).mean(), abs=2e-3)


@pytest.mark.parametrize("g", [0.0, 0.4, 0.8])
def test_brighter_colors_absorb_less(g):
    for invert in (on_host(medium_albedo), on_host(fitted_albedo)):
        found = np.array([invert(c, g) for c in np.linspace(0, 1, 50)])
        assert found[0] < 1e-3 and 0.999 < found[-1] < 1 and (np.diff(found) > -1e-6).all()
    found = np.array([on_host(dipole_albedo)(c, 1.4) for c in np.linspace(0, 1, 50)])
    assert found[0] == 0 and found[-1] > 0.999 and (np.diff(found) >= 0).all()


def test_channels_of_no_radius_are_lambertian():
    medium, flat = closures_of((0.8, 0.5, 0.2), (1.0, 0.0, 0.5))
    assert medium.kind == K.SUBSURFACE and flat.kind == K.DIFFUSE
    assert tuple(medium.weight) == pytest.approx((0.4, 0, 0.1)) and tuple(flat.weight) == pytest.approx((0, 0.25, 0))
    (flat,) = closures_of((0.8, 0.5, 0.2), NONE)
    assert flat.kind == K.DIFFUSE and tuple(flat.weight) == pytest.approx((0.4, 0.25, 0.1))


def test_media_of_methods():
    """Media by each method of Blender.

    A radius is a free path, scaled for skin and in the old way; forward scattering shortens it; indices are in the
    range of Cycles.
    """
    radius, color = (0.1, 0.1, 0.1), (0.5, 0.5, 0.5)
    (plain,) = closures_of(color, radius, 0.5)
    assert tuple(plain.edge) == pytest.approx((10, 10, 10)) and plain.multiscatter == 0 and plain.mean_cosine == 0.5
    (legacy,) = closures_of(color, radius, 0.5, SubsurfaceMethod.LEGACY, 0.1)
    assert tuple(legacy.edge) == pytest.approx((10 * 4 * np.pi * 2,) * 3, rel=1e-5) and legacy.ior == pytest.approx(
        1.01
    )
    (skin,) = closures_of(color, radius, 0.0, SubsurfaceMethod.SKIN, 9.0)
    reduced = on_host(dipole_albedo)(0.5, 3.8)
    assert skin.multiscatter == 1 and skin.roughness == 1 and skin.ior == pytest.approx(3.8)
    assert skin.edge[0] == pytest.approx(10 / np.sqrt(3 * (1 - reduced)), rel=1e-5)
    # factors for a walk's colour, and for the light that dark media lose at once
    assert plain.refraction[0] == pytest.approx(2, rel=1e-6)
    (dark,) = closures_of((0.01, 0.01, 0.01), radius)
    albedo = on_host(medium_albedo)(0.01, 0.0)
    assert dark.color[0] == pytest.approx(0.2) and dark.refraction[0] == pytest.approx(albedo / 0.2 / 0.01, rel=1e-4)
