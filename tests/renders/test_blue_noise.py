"""Renders whose samples are shared out among pixels: finer noise of the same picture, whatever the schedule."""

import numpy as np

from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

SETTINGS = RenderSettings(sample_count=4, sample_sequence="BLUE_NOISE", bounce_max=1, kernel_tier="SPECIALISED")
EDGE = 64


def soft_shadow(frame):
    """A ball on a floor under a large lamp."""
    return scenes.scene(
        [
            (scenes.plane("floor", 8.0), scenes.IDENTITY, scenes.diffuse()),
            (scenes.sphere("ball"), scenes.translation(0, 0, 1), scenes.diffuse(0.5)),
        ],
        view=scenes.camera(eye=(0, -6, 4), target=(0, 0, 0.5)),
        frame=frame,
        lights=[scenes.area_light(4.0, 3.0, scenes.translation(0.5, 0, 5))],
    )


def picture(session, settings, border=None, sample_first=0):
    film = session.render(soft_shadow(Frame(EDGE, EDGE, border=border)), settings, sample_first=sample_first)
    assert film.statistics["invalid_samples"] == 0
    return film


def color(film):
    return film.passes["Combined"][..., :3].astype(np.float64)


def smoothed(error):
    """`error` without its waves shorter than 8 pixels."""
    waves = np.fft.fftfreq(EDGE)
    coarse = np.hypot(*np.meshgrid(waves, waves)) <= 1 / 8
    return np.fft.ifft2(np.fft.fft2(error, axes=(0, 1)) * coarse[..., None], axes=(0, 1)).real


def test_noise_is_finer_and_no_more(session):
    """At one sample the error of a soft shadow has less than half of the power that Sobol points leave in its coarse
    waves, and about as much in all of them; either is the same picture.
    """
    exact = color(picture(session, SETTINGS.replace(sample_sequence="SOBOL", sample_count=512, seed=99, bounce_max=0)))
    coarse, whole, mean = {}, {}, {}
    for sequence in ("SOBOL", "BLUE_NOISE"):
        settings = SETTINGS.replace(sample_sequence=sequence, sample_count=1, bounce_max=0)
        errors = [color(picture(session, settings.replace(seed=seed))) - exact for seed in range(4)]
        coarse[sequence] = np.mean([smoothed(error) ** 2 for error in errors])
        whole[sequence] = np.mean(np.square(errors))
        mean[sequence] = np.mean(errors)
    assert coarse["BLUE_NOISE"] < coarse["SOBOL"] / 2
    assert whole["BLUE_NOISE"] < 1.1 * whole["SOBOL"]
    assert abs(mean["BLUE_NOISE"]) < 0.01 * exact.mean()


def test_numbers_belong_to_pixels_and_samples_alone(session):
    """Tiles, borders and ranges of samples give the same film to the bit."""
    whole = color(picture(session, SETTINGS))
    assert np.array_equal(whole, color(picture(session, SETTINGS.replace(tile_size=16, ray_count=999))))
    part = color(picture(session, SETTINGS, border=(5, 9, 41, 40)))
    assert np.array_equal(whole[9:40, 5:41], part)
    first, rest = (
        picture(session, SETTINGS.replace(sample_count=count), sample_first=start) for start, count in ((0, 1), (1, 3))
    )
    assert np.array_equal(whole, color(rest.merge(first)))
