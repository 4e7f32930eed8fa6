"""Skies as the host computes them: positions of the sun, pictures, the sun's disc, coefficients."""

import math

import numpy as np
import pytest

from raybatch_addon.core.sky import multiple_scattering
from raybatch_addon.core.sky.atmosphere import (
    PICTURE_HEIGHT,
    PICTURE_WIDTH,
    Atmosphere,
    horizon_elevation,
    sky_table,
    sun_direction,
    wrapped_sun,
)
from raybatch_addon.core.sky.hosek_wilkie import hosek_wilkie_table
from raybatch_addon.core.sky.multiple_scattering import MULTIPLE_SCATTERING
from raybatch_addon.core.sky.preetham import preetham_table, sun_angles
from raybatch_addon.core.sky.single_scattering import SINGLE_SCATTERING

MODELS = [SINGLE_SCATTERING, MULTIPLE_SCATTERING]
HALF = PICTURE_HEIGHT // 2


@pytest.mark.parametrize("rotation", [0.0, 1.0, -2.0, 9.0])
@pytest.mark.parametrize("elevation", [0.0, 0.3, 1.5, 1.7, 3.0, 4.0, 6.0, -0.2, -2.0, -5.0, 20.0])
def test_any_angles_are_a_place_in_the_sky(elevation, rotation):
    up, azimuth = wrapped_sun(elevation, rotation)
    assert abs(up) <= math.pi / 2 + 1e-6 and 0.0 <= azimuth <= 2 * math.pi + 1e-6
    # Blender's rotation turns the other way, from the y axis on
    flat = math.cos(elevation)
    expected = (flat * math.sin(rotation), flat * math.cos(rotation), math.sin(elevation))
    assert sun_direction(up, azimuth) == pytest.approx(expected, abs=3e-6)


def test_the_horizon_sinks_as_one_climbs():
    assert horizon_elevation(0.0) == 0.0
    assert horizon_elevation(10_000.0) == pytest.approx(-math.acos(6371.0 / 6381.0))


@pytest.mark.parametrize("model", MODELS)
def test_pictures_are_mirrored_at_the_suns_meridian(model):
    picture = model.sky_picture(Atmosphere(0.3))
    assert picture.shape == (PICTURE_HEIGHT, PICTURE_WIDTH, 3) and picture.dtype == np.float32
    assert np.isfinite(picture).all() and (picture >= 0).all()
    assert np.array_equal(picture, picture[:, ::-1])
    horizon = picture[HALF + 20, :, 1]
    assert abs(int(np.argmax(horizon)) - PICTURE_WIDTH / 2) <= 1  # brightest towards the sun
    assert picture[:HALF, :, 1].mean() < picture[HALF:, :, 1].mean()


@pytest.mark.parametrize("model", MODELS)
def test_skies_are_blue_at_noon_and_sunsets_red(model):
    zenith = model.sky_picture(Atmosphere(1.0))[-1, 0]
    assert zenith[2] > zenith[1] > 0
    high, low = (model.sun_disc(Atmosphere(elevation), 0.01).lowest for elevation in (1.0, 0.05))
    assert high[1] > low[1]
    assert low[0] / low[2] > 2 * high[0] / high[2]


@pytest.mark.parametrize("model", MODELS)
def test_without_air_the_sky_is_dark_and_the_sun_bright(model):
    empty, full = Atmosphere(0.5, air=0.0, aerosol=0.0, ozone=0.0), Atmosphere(0.5)
    assert model.sky_picture(empty)[HALF:, :, 1].max() < 1e-3 * model.sky_picture(full)[HALF:, :, 1].max()
    assert model.sun_disc(empty, 0.01).highest[1] > model.sun_disc(full, 0.01).highest[1]


@pytest.mark.parametrize("model", MODELS)
def test_a_sun_that_is_twice_as_wide_is_a_quarter_as_bright(model):
    small, large = (model.sun_disc(Atmosphere(1.2), size) for size in (0.01, 0.02))
    assert np.array(small.lowest) / np.array(large.lowest) == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    "values",
    [
        {"altitude": 0.0},
        {"altitude": 1e5},
        {"air": 1000.0, "aerosol": 1000.0, "ozone": 1000.0},
        {"sun_elevation": math.pi / 2},
        {"sun_elevation": -math.pi / 2},
    ],
)
def test_no_setting_makes_numbers_that_are_not_finite(model, values):
    atmosphere = Atmosphere(**{"sun_elevation": 0.2} | values)
    picture = model.sky_picture(atmosphere)
    assert np.isfinite(picture).all()
    disc = model.sun_disc(atmosphere, 0.0005)
    assert np.isfinite([*disc.lowest, *disc.highest]).all()


def test_a_single_scattering_sun_below_the_horizon_is_dark():
    assert SINGLE_SCATTERING.sun_disc(Atmosphere(-0.2), 0.01).highest == (0.0, 0.0, 0.0)


def test_tables_of_scattering_skies():
    disc = SINGLE_SCATTERING.sun_disc(Atmosphere(0.5), 0.01)
    table = sky_table(disc, 0.5, 1.0, 0.01, 2.0, 100.0)
    assert table[:6] == [*disc.lowest, *disc.highest] and table[6:10] == [0.5, 1.0, 0.01, 2.0]
    assert sky_table(None, 0.5, 1.0, 0.01, 2.0, 100.0)[8] < 0.0


@pytest.mark.parametrize("table", [preetham_table, lambda sun, t: hosek_wilkie_table(sun, t, 0.3)])
def test_tables_of_formulas(table):
    for turbidity in (1.0, 2.5, 10.0):
        for sun in ((0, 0, 1), (0, 0, 5), (1, 0, 0), (0.2, -0.3, -0.1), (0, 0, 0), (math.nan, 0, 1)):
            numbers = table(sun, turbidity)
            assert len(numbers) == 32 and np.isfinite(numbers).all()
    assert table((0, 0, 1), 3.0) == table((0, 0, 7), 3.0)


def test_turbidities_between_whole_ones_are_blended():
    low, between, high = (np.array(hosek_wilkie_table((0.3, 0.2, 0.5), t, 0.4)) for t in (3.0, 3.25, 4.0))
    assert between == pytest.approx(0.75 * low + 0.25 * high)


def test_angles_of_the_sun():
    assert sun_angles((1, 0, 0)) == pytest.approx((math.pi / 2, math.pi / 2))
    assert sun_angles((0, 2, 0)) == pytest.approx((0.0, math.pi / 2))
    assert sun_angles((0, 0, -1))[1] == pytest.approx(math.pi)


def test_the_table_of_kernels_is_what_numpy_computes():
    atmosphere = Atmosphere(0.0, 0.0, 0.7, 2.0, 1.5)
    table = multiple_scattering._lit_table(0.7, 2.0, 1.5).numpy()
    height, width = table.shape[:2]
    cosine = np.linspace(-1, 1, width, dtype=np.float32)[None, :]
    heights = np.linspace(0, 1, height, dtype=np.float32)[:, None]
    expected = multiple_scattering._transmittance(*np.broadcast_arrays(cosine, heights), atmosphere)
    assert np.abs(table - expected).max() < 1e-5 and (table > 0.5).any()
