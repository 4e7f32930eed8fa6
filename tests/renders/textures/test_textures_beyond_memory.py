"""Images beyond their budget: the film is that of images in memory, on every schedule."""

import dataclasses
import re
import threading

import numpy as np
import pytest

from raybatch_addon.core.ahead import prepare
from raybatch_addon.core.errors import OutOfMemoryError
from raybatch_addon.core.programs.requests import prepared_scene
from raybatch_addon.core.scene.description import Image, ImageEncoding
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.images.image_upload import device_bytes_of
from raybatch_addon.core.shading.images.textures import Extension, Interpolation
from raybatch_addon.core.wavefront.render.steps import TileSteps
from tests.support.images import textured_scenes
from tests.support.images.textured_scenes import COLORS, sky
from tests.support.running.shares import each_of
from tests.support.watched_renders import stopping

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")
WHOLE = RenderSettings(sample_count=4, bounce_max=3, seed=3, thread_count=1)
TILED = WHOLE.replace(texture_tile_size=16, texture_budget=150_000)
FILTERED = dict(texture_filter="FOOTPRINT", texture_filter_width=1.0)
CLOUDS = np.random.default_rng(3).integers(0, 256, (100, 150, 3), np.uint8)


def room(*how):
    """The room below a world that shows an image, which is held whole: most tests have these kernels."""
    made = textured_scenes.room(*how)
    images = (*made.images, Image("clouds", freeze(CLOUDS), ImageEncoding.SRGB))
    return dataclasses.replace(made, images=images, world=sky(len(made.images)))


def same(film, expected) -> bool:
    return all(np.array_equal(film.passes[name], values) for name, values in expected.passes.items())


def enough(session, scene, settings) -> int:
    """The least budget, as the message has it."""
    with pytest.raises(OutOfMemoryError) as refused:
        session.render(scene, settings)
    return int(re.search(r"needs ([\d,]+) at least", str(refused.value))[1].replace(",", ""))


@pytest.fixture(scope="module")
def whole(session):
    return session.render(room(), WHOLE)


@pytest.mark.parametrize(
    "change",
    each_of(
        6,
        [
            {},
            dict(texture_budget=700_000, texture_tile_size=64),
            dict(ray_count=37),
            dict(ray_count=1),
            dict(thread_count=3, tile_size=7),
            dict(sample_order="PIXEL_FIRST", tile_size=5),
            dict(batching="ON", treelet_size=8),
            dict(batching="ON", treelet_size=8, ray_storage="DIRECT", ray_count=50, debug_checks="ON"),
            dict(batching="ON", geometry_budget=200_000),
            dict(ray_sort="ON", hit_sort="ON", counters="ON"),
        ],
    ),
    ids=str,
)
def test_the_film_is_that_of_images_in_memory(session, whole, change):
    film = session.render(room(), TILED.replace(**change))
    assert same(film, whole)
    tiles = film.statistics["images"]["tiles"]
    assert tiles["fetched"] > 0 and tiles["lost"] == 0 and film.statistics["invalid_samples"] == 0
    assert film.statistics["rays"] == whole.statistics["rays"]


def test_a_tile_is_shown_after_a_sample_and_then_on_a_gpu_after_as_many_paths_as_wait_together(
    session, device, monkeypatch
):
    monkeypatch.setattr(TileSteps, "samples", lambda *_: 1)  # whatever time they take
    shown, samples = [], 64
    settings = dict(sample_count=samples, tile_order="PROGRESSIVE", tile_size=20, ray_count=20 * 16 * samples)
    film = session.render(room(), TILED.replace(**settings), on_tile=shown.append)
    assert same(film, session.render(room(), WHOLE.replace(**settings)))
    assert len(shown) == (2 if device != "cpu" else samples)


def test_the_least_pool_is_named_and_is_enough(session, whole):
    least = enough(session, room(), TILED.replace(texture_budget=20_000 + CLOUDS.nbytes))
    film = session.render(room(), TILED.replace(texture_budget=least))
    tiles = film.statistics["images"]["tiles"]
    assert same(film, whole) and tiles["slots"] < tiles["tiles"] / 10 and tiles["evicted"] > tiles["slots"]
    with pytest.raises(OutOfMemoryError, match=r"texture_budget is .* raise it, or lower texture_tile_size"):
        session.render(room(), TILED.replace(texture_budget=least - 1))


def test_a_budget_that_is_too_small_is_refused_while_kernels_are_compiled(device, monkeypatch):
    """The message has what all workers need."""
    goes_on, session, budget = threading.Event(), Session(device), 20_000 + CLOUDS.nbytes
    monkeypatch.setattr(prepare, "load_kernels", lambda *_: goes_on.wait(60) and [])
    try:
        least = [enough(session, room(), TILED.replace(texture_budget=budget, thread_count=n)) for n in (1, 3)]
        assert not goes_on.is_set() and (least[0] < least[1] if device == "cpu" else least[0] == least[1])
    finally:
        goes_on.set()
        session.close()


@pytest.mark.parametrize("extension", list(Extension))
@pytest.mark.parametrize("interpolation", list(Interpolation))
def test_all_look_ups_are_those_of_images_in_memory(session, interpolation, extension):
    scene, one = room(interpolation, extension), dict(sample_count=1)
    assert same(session.render(scene, TILED.replace(**one)), session.render(scene, WHOLE.replace(**one)))


def test_filtered_images_are_too(session):
    scene = textured_scenes.room()  # whose world is one color
    expected = session.render(scene, WHOLE.replace(**FILTERED))
    film = session.render(scene, TILED.replace(**FILTERED))
    assert same(film, expected)
    names = ("filtered_look_ups", "other_look_ups", "count")
    assert all(film.statistics["images"][name] == expected.statistics["images"][name] for name in names)


def test_a_stopped_render_goes_on(session, whole):
    settings = TILED.replace(ray_count=64)
    with stopping(60):
        part = session.render(room(), settings)
    assert not part.complete
    assert same(session.render(room(), settings, resume=part), whole)


def test_films_of_sample_ranges_merge_to_that_of_all(session, whole):
    parts = [session.render(room(), TILED.replace(sample_count=2), sample_first=first) for first in (0, 2)]
    assert np.array_equal(parts[0].merge(parts[1]).passes["Combined"], whole.passes["Combined"])


def test_a_session_renders_with_and_without_in_turns(whole):
    with_caches = Session("cpu")
    for settings in (TILED, WHOLE, TILED, TILED.replace(seed=4), TILED):
        film = with_caches.render(room(), settings)
        assert settings.seed != WHOLE.seed or same(film, whole)
    with_caches.close()


def test_statistics_say_what_was_fetched(session):
    film = session.render(room(), TILED)
    reported = film.statistics["images"]["tiles"]
    assert reported["slot_bytes"] == 4 * 16 * 16 and reported["tiles"] > reported["slots"] > 0
    assert reported["fetched"] - reported["evicted"] <= reported["slots"]
    assert 0 < reported["bytes"] <= reported["fetched"] * reported["slot_bytes"]
    assert 0 < reported["waited"] <= reported["looked"] <= film.statistics["rays"]["total"]
    assert reported["waited_share"] == pytest.approx(reported["waited"] / reported["looked"], abs=1e-6)
    assert "images in tiles" not in film.statistics["left_out"]


def test_what_fits_is_rendered_as_ever(session, whole):
    budget = device_bytes_of(room().images)
    film = session.render(room(), TILED.replace(texture_budget=budget))
    assert "tiles" not in film.statistics["images"] and "images in tiles" in film.statistics["left_out"]
    assert film.statistics["modules"] == whole.statistics["modules"]
    scene = room()
    assert prepared_scene(scene, TILED, budget) is scene


def test_what_cannot_wait_is_held_whole_or_refused_by_name(session, whole):
    film = session.render(room(), TILED)
    assert same(film, whole) and film.statistics["images"]["bytes"] > CLOUDS.nbytes
    with pytest.raises(OutOfMemoryError, match="“clouds”, of the world"):
        session.render(room(), TILED.replace(texture_budget=40_000))


@pytest.mark.thorough  # has kernels of its own
def test_what_waits_nowhere_is_held_whole_for_surfaces_too(session):
    under = dataclasses.replace(textured_scenes.room(), world=sky())
    expected, film = session.render(under, WHOLE), session.render(under, TILED.replace(texture_budget=700_000))
    assert same(film, expected) and film.statistics["images"]["bytes"] > under.images[COLORS].pixels.nbytes
    with pytest.raises(OutOfMemoryError, match="“colors”, of the world"):
        session.render(under, TILED)


def test_broken_texels_are_repaired_and_named(session):
    scene = room()
    pixels = scene.images[1].pixels.copy()
    pixels[3, 5] = np.nan
    images = list(scene.images)
    images[1] = Image("Greys", pixels)
    scene = dataclasses.replace(scene, images=tuple(images))
    expected, film = (session.render(scene, each.replace(sample_count=1)) for each in (WHOLE, TILED))
    assert same(film, expected)
    assert any("Greys" in line and "1 texels" in line for line in film.statistics["warnings"])
