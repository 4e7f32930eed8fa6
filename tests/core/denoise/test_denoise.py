"""Denoising of arrays, by the library that Blender brings."""

import numpy as np
import pytest

from raybatch_addon.blender.denoise_library import library_places
from raybatch_addon.core.convergence.halves import filtered_half_error
from raybatch_addon.core.denoise.library import FILE_NAMES, VARIABLE, DenoiseStoppedError, open_library
from raybatch_addon.core.denoise.picture import denoised, denoised_catchers, guiding_passes
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.settings.settings import RenderSettings

SHAPE = (48, 64)
HAS_LIBRARY = any((place / name).is_file() for place in library_places() for name in FILE_NAMES)
needs_library = pytest.mark.skipif(not HAS_LIBRARY, reason="no Blender with Open Image Denoise is there")
ON = RenderSettings(denoise="ON")


@pytest.fixture(scope="module")
def library():
    return open_library(places=library_places())


def true_picture() -> np.ndarray:
    """Stripes of light in a dark room, brighter than white, float32, shape [48, 64, 3]."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.stack([np.where((x // 8) % 2, 4.0, 0.25), 0.02 * x, 0.01 * y + 0.1], -1).astype(np.float32)


def noisy_passes(seed: int) -> dict[str, np.ndarray]:
    """A film of that picture with noise, whose albedo has its stripes, slightly noisy."""
    random, truth = np.random.default_rng(seed), true_picture()
    color = truth * random.gamma(4.0, 0.25, (*SHAPE, 3))
    alpha = random.random((*SHAPE, 1))
    albedo = np.clip(truth / 4 + 0.02 * random.standard_normal((*SHAPE, 3)), 0, 1)
    normal = np.zeros((*SHAPE, 3))
    normal[..., 2] = -1
    passes = {"Combined": np.concatenate([color, alpha], -1), "Denoising Albedo": albedo, "Denoising Normal": normal}
    return {name: values.astype(np.float32) for name, values in passes.items()}


def error_of(picture: np.ndarray) -> float:
    return float(np.mean((picture[..., :3] - true_picture()) ** 2))


@needs_library
def test_a_denoised_picture_is_nearer_to_the_truth_and_guides_bring_it_nearer_still(library):
    passes = noisy_passes(1)
    before = {name: values.copy() for name, values in passes.items()}
    alone = denoised(passes, ON.replace(denoise_inputs="NONE"), library)
    guided = denoised(passes, ON, library)
    assert error_of(guided) < error_of(alone) < 0.5 * error_of(passes["Combined"])
    assert guided.dtype == np.float32 and np.isfinite(guided).all() and guided[..., :3].max() > 2  # HDR
    assert np.array_equal(guided[..., 3], passes["Combined"][..., 3])
    assert all(np.array_equal(values, before[name]) for name, values in passes.items())


@needs_library
@pytest.mark.parametrize("prefilter", ["NONE", "FAST", "ACCURATE"])
def test_denoising_repeats_bit_for_bit_and_every_prefilter_gives_another_picture(library, prefilter):
    passes, settings = noisy_passes(2), ON.replace(denoise_prefilter=prefilter, denoise_quality="FAST")
    picture = denoised(passes, settings, library)
    assert np.array_equal(picture, denoised(passes, settings, library))
    others = [name for name in ("NONE", "FAST", "ACCURATE") if name != prefilter]
    assert all(
        not np.array_equal(picture, denoised(passes, settings.replace(denoise_prefilter=name), library))
        for name in others
    )


@needs_library
def test_the_error_of_denoised_halves_is_given_without_the_truth(library):
    settings = ON.replace(denoise_inputs="NONE", denoise_quality="FAST")
    reported, true = [], []
    for seed in range(6):
        noisy = [noisy_passes(10 * seed + half) for half in range(2)]
        clean = [denoised(each, settings, library)[..., :3] for each in noisy]
        reported.append(filtered_half_error(*(each["Combined"][..., :3] for each in noisy), *clean).rmse ** 2)
        true.append(np.mean([error_of(each) for each in clean]))
    spread = np.std(np.subtract(reported, true), ddof=1) / np.sqrt(len(reported))
    assert abs(np.mean(reported) - np.mean(true)) < 4 * spread
    assert spread < 0.25 * np.mean(true)  # else the line above says little


@needs_library
def test_shadows_on_catchers_are_denoised_in_alpha_and_in_their_pass(library):
    x = np.arange(SHAPE[1])
    shadow = np.broadcast_to(np.where(abs(x - 32) < 12, 0.7, 0.1)[:, None], (*SHAPE, 1)).astype(np.float32)
    noise = np.random.default_rng(5).normal(0, 0.1, shadow.shape).astype(np.float32)
    passes = noisy_passes(3)
    passes["Combined"] = np.concatenate([passes["Combined"][..., :3], np.clip(shadow + noise, 0, 1)], -1)
    passes["Shadow Catcher"] = np.repeat(1 - shadow - noise, 3, -1)
    off = ON.replace(denoise_inputs="NONE")
    assert np.array_equal(denoised(passes, off, library)[..., 3], passes["Combined"][..., 3])
    alpha = denoised(passes | {"Catcher Shadows": shadow}, off, library)[..., 3:]
    (shown,) = denoised_catchers(passes, off, library).values()
    for found, noisy, truth in (
        (alpha, passes["Combined"][..., 3:], shadow),
        (shown, passes["Shadow Catcher"], 1 - shadow),
    ):
        assert np.mean((found - truth) ** 2) < 0.2 * np.mean((noisy - truth) ** 2)
    assert not denoised_catchers(noisy_passes(3), off, library)


@needs_library
def test_only_who_gives_up_is_stopped(library):
    passes = noisy_passes(4)
    with pytest.raises(DenoiseStoppedError):
        denoised(passes, ON, library, lambda: True)
    assert np.array_equal(denoised(passes, ON, library, lambda: False), denoised(passes, ON, library))


def test_guiding_passes_are_rendered_only_for_a_denoiser():
    assert guiding_passes(RenderSettings()) == ()
    assert guiding_passes(ON) == ("Denoising Albedo", "Denoising Normal")
    assert guiding_passes(ON.replace(denoise_inputs="ALBEDO")) == ("Denoising Albedo",)
    assert guiding_passes(ON.replace(denoise_inputs="NONE")) == ()


def test_a_library_that_is_not_there_is_reported_with_its_path_and_the_cure(tmp_path, monkeypatch):
    with pytest.raises(
        RayBatchError, match="there is no file .*nowhere.*denoise_library.*or turn Denoise .denoise. off"
    ):
        open_library(str(tmp_path / "nowhere.so"))
    monkeypatch.setenv(VARIABLE, str(tmp_path / "elsewhere.so"))
    with pytest.raises(RayBatchError, match=f"elsewhere.so .{VARIABLE}"):
        open_library()


def test_what_is_no_library_is_reported_by_its_path(tmp_path):
    (tmp_path / FILE_NAMES[0]).write_text("not a library")
    with pytest.raises(RayBatchError, match="is not Open Image Denoise 2"):
        open_library(str(tmp_path))
