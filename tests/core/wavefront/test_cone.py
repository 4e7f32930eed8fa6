"""Cones around rays: how they grow, bend at curved mirrors, and widen by rough ones."""

import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import Geometry, upload_geometry
from raybatch_addon.core.shading.bsdf.materials import DELTA, GLOSSY, TRANSMISSION
from raybatch_addon.core.wavefront.stages.surface.cone import cone_width, make_scattered_cone
from raybatch_addon.core.wavefront.stages.surface.vertex import Vertex
from tests.support import scenes
from tests.support.under_test import DEVICE

RADIUS = 2.0


@functools.cache
def kernel(smooth: bool):
    scattered_cone = make_scattered_cone(smooth)

    @wp.kernel(**KERNEL_OPTIONS)
    def run(
        geometry: Geometry,
        outside: float,
        cone: wp.vec2,
        distance: float,
        lobe: int,
        pdf: float,
        out: wp.array(dtype=wp.vec2),
    ):
        v = Vertex()
        v.wo = wp.vec3(0.0, 0.0, outside)
        v.surface.geometric_normal = wp.vec3(0.0, 0.0, 1.0)
        i = wp.tid()
        out[i] = scattered_cone(geometry, v, cone, 0, i, distance, lobe, pdf)

    return run


def scattered(cone, distance, lobe, pdf=0.0, smooth=True, outside=1.0, scale=1.0):
    """Cones behind a scattering at each triangle of a sphere of radius RADIUS."""
    ball = scenes.sphere(segments=64, rings=32, radius=RADIUS / scale, smooth=smooth)
    scene = scenes.scene([(ball, scenes.translation(0, 0, 0, scale), scenes.diffuse())])
    geometry = upload_geometry(flatten(scene), scene, wp.get_device(DEVICE))
    out = wp.zeros(len(ball.triangles), dtype=wp.vec2, device=DEVICE)
    inputs = [geometry, outside, wp.vec2(*cone), distance, int(lobe), pdf, out]
    wp.launch(kernel(smooth), len(out), inputs, device=DEVICE)
    return out.numpy().astype(float)


def test_a_cone_grows_with_distance_and_again_behind_its_focus():
    assert cone_width(wp.vec2(0.5, 0.25), 2.0) == 1.0
    assert cone_width(wp.vec2(0.5, -0.25), 4.0) == 0.5


@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_a_ball_mirror_widens_a_cone_by_twice_its_curvature(scale):
    cones = scattered((0.01, 0.02), 0.5, GLOSSY | DELTA, scale=scale)
    assert np.allclose(cones[:, 0], 0.02)
    # corners of a triangle are on the sphere: their normals are exact, but for triangles at the poles that are slivers
    assert np.allclose(cones[:, 1], 0.02 + 2 * 0.02 / RADIUS, rtol=1e-3)


def test_a_hollow_mirror_narrows_it():
    cones = scattered((0.02, 0.0), 0.0, GLOSSY | DELTA, outside=-1.0)
    assert np.allclose(cones[:, 1], -2 * 0.02 / RADIUS, rtol=1e-3)


@pytest.mark.parametrize("lobe, smooth", [(GLOSSY | DELTA, False), (TRANSMISSION | DELTA, True)])
def test_flat_mirrors_and_what_lets_through_leave_it(lobe, smooth):
    assert np.allclose(scattered((0.0, 0.1), 1.0, lobe, smooth=smooth), (0.1, 0.1))


def test_a_rough_surface_adds_the_squares_of_widths():
    density = 4.0
    cones = scattered((0.0, 0.1), 1.0, GLOSSY, density, smooth=False)
    # a disc of a sixteenth of the solid angle that a sample stands for
    added = 2 * np.sqrt(1 / (16 * density * np.pi))
    assert np.allclose(cones[:, 1], np.hypot(0.1, added))


def test_a_spread_has_a_limit():
    assert np.allclose(scattered((0.0, 0.1), 1.0, GLOSSY, 1e-6, smooth=False)[:, 1], 1.0)
