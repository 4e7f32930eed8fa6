"""Skies by direction: values of Blender 5.2's Cycles in a few directions, and the ends of the range of numbers."""

import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.ops.textures.sky import hosek_wilkie_sky, preetham_sky, scattering_sky
from raybatch_addon.core.scene.description import Image
from raybatch_addon.core.shading.images.image_upload import ImageCache
from raybatch_addon.core.shading.images.textures import ImageTable
from raybatch_addon.core.sky.atmosphere import Atmosphere, sky_table, wrapped_sun
from raybatch_addon.core.sky.hosek_wilkie import hosek_wilkie_table
from raybatch_addon.core.sky.multiple_scattering import MULTIPLE_SCATTERING
from raybatch_addon.core.sky.preetham import preetham_table
from raybatch_addon.core.sky.single_scattering import SINGLE_SCATTERING
from tests.support.under_test import DEVICE

SUN = (0.5, 0.3, 0.4)
TABLES = {"preetham": preetham_table(SUN, 3.7), "hosek_wilkie": hosek_wilkie_table(SUN, 3.7, 0.4)}
MODELS = {"single": SINGLE_SCATTERING, "multiple": MULTIPLE_SCATTERING}
DIRECTIONS = [
    (0.6, 0.48, 0.64),
    (-0.48, 0.6, 0.64),
    (0.8, -0.6, 0.0),
    (0.64, 0.768, -0.024),
    (-0.6, -0.8, 0.0001),
    (0.0, 0.0, 1.0),
    (0.36, 0.48, -0.8),
]
CYCLES = {
    "preetham": [
        (1.360989, 1.47461, 1.885538),
        (0.2533, 0.4115914, 0.6984263),
        (0.5914229, 0.4871759, 0.4854085),
        (1.074268, 0.7783132, 0.6823923),
        (0.4516258, 0.3950188, 0.4063458),
        (0.2683141, 0.4316284, 0.7923495),
        (0.4911001, 0.4250445, 0.4358388),
    ],
    "hosek_wilkie": [
        (0.237206, 0.2489233, 0.2500989),
        (0.03286169, 0.05715705, 0.1009617),
        (0.1385813, 0.15459, 0.1372617),
        (0.2944238, 0.3019418, 0.2421694),
        (0.1574182, 0.186941, 0.1733113),
        (0.0232158, 0.0386945, 0.07271604),
        (0.1177692, 0.1357109, 0.1234942),
    ],
    "single": [
        (1.397447, 2.146478, 3.720033),
        (0.8431432, 1.366723, 2.447678),
        (11.44628, 9.409473, 6.099546),
        (4.768706, 4.338562, 3.114935),
        (5.446489, 5.055134, 3.694087),
        (0.9619452, 1.479282, 2.653612),
        (0.0, 0.0, 0.0),
    ],
    "multiple": [
        (1.602312, 3.300558, 6.551826),
        (1.19204, 2.490728, 5.066623),
        (21.45419, 21.25041, 18.56989),
        (13.83485, 13.97124, 13.77613),
        (15.44448, 15.77977, 14.52081),
        (1.053003, 2.211428, 4.563656),
        (0.601092, 0.9732426, 1.729708),
    ],
}
# a sun of 0.05 rad and half its intensity: its middle, two directions within it, one outside
SUN_DIRECTIONS = [
    (0.632629216, -0.290245712, 0.718009531),
    (0.647060454, -0.293934494, 0.703502178),
    (0.623326659, -0.297374964, 0.72320962),
    (0.65713805, -0.280853152, 0.699493468),
]
CYCLES_SUN = {
    "single": [
        (48109.45, 39566.39, 30881.41),
        (36853.32, 30269.5, 23542.37),
        (43283.49, 35614.52, 27832.81),
        (7.452856, 7.387242, 8.35163),
    ],
    "multiple": [
        (52530.68, 44680.84, 34042.27),
        (40235.97, 34172.17, 25942.89),
        (47262.08, 40221.86, 30685.53),
        (3.471533, 5.487951, 9.179057),
    ],
}


@wp.kernel(**KERNEL_OPTIONS)
def formula(kind: int, table: wp.array(dtype=float), directions: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    if kind == 0:
        out[i] = preetham_sky(table, 1, directions[i])
    else:
        out[i] = hosek_wilkie_sky(table, 1, directions[i])


@wp.kernel(**KERNEL_OPTIONS)
def picture(
    images: ImageTable, table: wp.array(dtype=float), directions: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.vec3)
):
    i = wp.tid()
    out[i] = scattering_sky(images, 0, table, 1, directions[i])


@functools.cache
def uploaded(name):
    elevation, _ = wrapped_sun(0.8, 2.0)
    atmosphere = Atmosphere(elevation, 2000.0, 1.2, 2.0, 0.5)
    return atmosphere, ImageCache().upload([Image("sky", MODELS[name].sky_picture(atmosphere))], DEVICE)


def sky(name, directions, sun=False):
    out = wp.zeros(len(directions), dtype=wp.vec3, device=DEVICE)
    places = wp.array(np.asarray(directions, np.float32), dtype=wp.vec3, device=DEVICE)
    if name in TABLES:
        table = wp.array([0.0, *TABLES[name]], dtype=float, device=DEVICE)
        wp.launch(formula, len(directions), [list(TABLES).index(name), table, places, out], device=DEVICE)
        return out.numpy()
    atmosphere, images = uploaded(name)
    elevation, azimuth = wrapped_sun(0.8, 2.0)
    disc = MODELS[name].sun_disc(atmosphere, 0.05) if sun else None
    table = wp.array(
        [0.0, *sky_table(disc, elevation, azimuth, 0.05, 0.5, atmosphere.altitude)], dtype=float, device=DEVICE
    )
    wp.launch(picture, len(directions), [images.table, table, places, out], device=DEVICE)
    return out.numpy()


@pytest.mark.parametrize("name", list(CYCLES))
def test_skies_are_those_of_cycles(name):
    assert sky(name, DIRECTIONS) == pytest.approx(np.array(CYCLES[name]), rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("name", list(CYCLES_SUN))
def test_suns_are_those_of_cycles(name):
    assert sky(name, SUN_DIRECTIONS, sun=True) == pytest.approx(np.array(CYCLES_SUN[name]), rel=2e-5)
    assert sky(name, SUN_DIRECTIONS)[0].max() < 1e-2 * CYCLES_SUN[name][0][0]  # without its disc


@pytest.mark.parametrize("name", list(CYCLES))
def test_any_direction_gives_finite_numbers(name):
    extremes = [0.0, -0.0, 1.0, -1.0, 1e7, -1e30, 1e-30, np.inf, -np.inf, np.nan]
    directions = np.random.default_rng(9).choice(extremes, (300, 3))
    found = sky(name, directions, sun=name in MODELS)
    assert np.isfinite(found).all() and (found >= 0.0).all()
