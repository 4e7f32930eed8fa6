"""The film's sums are exact, whatever the order and the partition of the samples."""

import dataclasses
import math

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.film import Film, layout_of
from raybatch_addon.core.film import sums as sums_module
from raybatch_addon.core.film.host_samples import HostSamples
from raybatch_addon.core.film.rounding import rounded_sum
from raybatch_addon.core.film.sums import WIDE_DIGITS, WINDOW_DIGITS, ExactSums
from raybatch_addon.core.film.tile import FilmTile, FilmTiles, FinishedTile
from raybatch_addon.core.scene.description import Frame
from tests.support.under_test import DEVICE


@wp.kernel(**KERNEL_OPTIONS)
def add_all(window: wp.array2d(dtype=wp.int64), wide: wp.array2d(dtype=wp.int64), values: wp.array2d(dtype=float)):
    i, j = wp.tid()
    if not sums_module.add_window(window, j, values[i, j]):
        sums_module.add_wide(wide, j, values[i, j])


def summed(values: np.ndarray) -> ExactSums:
    count = values.shape[1]
    window = np.zeros((WINDOW_DIGITS, count), np.int64)
    wide = np.zeros((WIDE_DIGITS, count), np.int64)
    on_device = [wp.array(a, device=DEVICE) for a in (window, wide, values)]
    wp.launch(add_all, values.shape, on_device, device=DEVICE)
    return ExactSums(on_device[0].numpy(), on_device[1].numpy(), 1)


@wp.kernel(**KERNEL_OPTIONS)
def round_all(
    window: wp.array2d(dtype=wp.int64), wide: wp.array2d(dtype=wp.int64), rounded: wp.array(dtype=wp.float64)
):
    i = wp.tid()
    rounded[i] = rounded_sum(window, wide, i)


def rounded_on_device(sums: ExactSums) -> np.ndarray:
    window, wide = (wp.array(digits, dtype=wp.int64, device=DEVICE) for digits in (sums.window, sums.wide))
    rounded = wp.zeros(window.shape[1], dtype=wp.float64, device=DEVICE)
    wp.launch(round_all, rounded.size, [window, wide, rounded], device=DEVICE)
    return rounded.numpy()


def fsums(values: np.ndarray) -> np.ndarray:
    return np.array([math.fsum(column.tolist()) for column in values.T])


@pytest.mark.parametrize("exponents", [(-5, 5), (-39, 30), (-75, 4), (-149, 127)])
def test_sums_equal_fsum(exponents):
    rng = np.random.default_rng(7)
    values = (rng.standard_normal((400, 32)) * 2.0 ** rng.integers(*exponents, (400, 32))).astype(np.float32)
    values[~np.isfinite(values)] = np.finfo(np.float32).max
    sums = summed(values)
    assert np.array_equal(sums.sums()[:, 0], fsums(values))
    assert np.array_equal(rounded_on_device(sums), fsums(values))


def test_ties_and_cancellation_round_once():
    one = 1.0
    columns = [
        [one, 2.0**-53, 0.0],  # a tie, to even
        [one, 2.0**-53, 2.0**-149],  # just above the tie
        [one + 2.0**-23, 2.0**-54, -(2.0**-140)],
        [3e38, -3e38, 2.0**-149],
        [3.4e38, 3.4e38, 3.4e38],
        [0.0, -0.0, 0.0],
        [-one, -(2.0**-53), -(2.0**-149)],
    ]
    values = np.array(columns, np.float32).T
    assert np.array_equal(summed(values).sums()[:, 0], fsums(values))
    assert np.array_equal(rounded_on_device(summed(values)), fsums(values))


@pytest.mark.parametrize("sign", [1, -1])
def test_sums_that_leave_the_window_are_rounded_once_on_the_device(sign):
    """Digits without wide ones beside them, up to what 2^31 samples give, at ties and beside them."""
    rng = np.random.default_rng(11)
    window = rng.integers(-(2**62), 2**62, (WINDOW_DIGITS, 256)) >> rng.integers(0, 62, (WINDOW_DIGITS, 256))
    window[:, :4] = 0
    window[3, :4] = 2**53 + 1, 2**54 + 2, 2**54 + 6, 2**62
    window[0, 1:3] = 1, -1
    sums = ExactSums(sign * window, np.zeros((0, 0), np.int64), 1)
    assert np.array_equal(rounded_on_device(sums), sums.sums()[:, 0])


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=1, max_size=40), st.randoms())
def test_any_order_and_partition_gives_the_same_bits(values, random):
    column = np.array(values, np.float32)[:, None]
    whole = summed(column)
    shuffled = list(values)
    random.shuffle(shuffled)
    cut = random.randint(0, len(shuffled))
    parts = [summed(np.array(part, np.float32).reshape(-1, 1)) for part in (shuffled[:cut], shuffled[cut:]) if part]
    total = parts[0] if len(parts) == 1 else parts[0].add(parts[1])
    assert total.sums()[0, 0] == whole.sums()[0, 0] == math.fsum(values)


def film_tiles(transparent: bool = False, spill_capacity: int = 12) -> FilmTiles:
    device = wp.get_device(DEVICE)
    spilled = wp.zeros(1, dtype=int, device=device)
    return FilmTiles(layout_of(("Combined",), transparent), ("Combined",), device, spilled, spill_capacity)


def black_tile(pixel_count: int) -> FilmTile:
    return film_tiles().begin(pixel_count)


def test_a_sample_outside_the_window_is_set_aside_and_kept():
    tiles = film_tiles()
    tile = tiles.begin(1)
    assert not tiles.take_spill(tile, 0) and tile.wide.size == 0
    tile.spill_index.assign(np.array([0, 2] + [0] * 10, np.int32))
    tile.spill_value.assign(np.array([1e30, 1e-30] + [0] * 10, np.float32))
    tile.spill_count.assign([2])
    assert not tiles.take_spill(tile, 2)
    sums = ExactSums(tile.window.numpy(), tile.wide.numpy(), 3).sums()[0]
    assert sums.tolist() == [float(np.float32(1e30)), 0.0, float(np.float32(1e-30))]
    assert tile.spill_count.numpy()[0] == 0


def film_of(samples: np.ndarray, frame: Frame) -> Film:
    film = Film.empty(frame)
    film.sums.window[:] = summed(samples).window
    film.counts[:] = len(samples)
    return film


def test_merging_gives_the_bits_of_one_render():
    frame = Frame(4, 2)
    samples = np.random.default_rng(1).random((10, 24), np.float32)
    whole, first, second = film_of(samples, frame), film_of(samples[:3], frame), film_of(samples[3:], frame)
    merged = second.merge(first)
    assert np.array_equal(merged.passes["Combined"], whole.passes["Combined"])
    assert merged.passes["Combined"].shape == (2, 4, 4)
    assert np.all(merged.passes["Combined"][..., 3] == 1)


def test_channels_are_asked_for_passes_that_are_summed():
    layout = layout_of(("Combined", "Normal"), transparent=True)
    assert layout.span("Combined") == slice(0, 4) and layout.span("Normal") == slice(4, layout.count)
    with pytest.raises(ValueError, match="'Depth' has no channels"):
        layout.span("Depth")


def test_merging_films_of_different_frames_is_refused():
    with pytest.raises(RayBatchError, match="differ in size"):
        Film.empty(Frame(4, 2)).merge(Film.empty(Frame(2, 4)))


def finished(x: int, y: int, values: np.ndarray) -> FinishedTile:
    """A tile of one row whose pixels have each one sample, `values` [pixels, 3]."""
    tile = black_tile(len(values))
    window = np.zeros((WINDOW_DIGITS, values.size), np.int64)
    window[WINDOW_DIGITS - 1] = values.ravel()
    tile.window.assign(window)
    tile.counts.fill_(1)
    return FinishedTile((x, y, len(values), 1), tile, layout_of(("Combined",), False), ("Combined",), len(values))


@pytest.mark.parametrize("resumed", [False, True])
def test_tiles_land_where_they_belong(resumed):
    film = Film.empty(Frame(8, 6, border=(2, 1, 7, 5)))
    values = np.array([[1, 2, 3], [4, 5, 6]])
    if resumed:  # a pixel elsewhere has a sample already, so that pictures come from the sums
        film.counts[0] = 1
    shown = film.add_tile(finished(3, 2, values))
    picture = film.passes["Combined"]
    assert picture.shape == (4, 5, 4)
    assert picture[1, 1:3, :3].tolist() == values.tolist()
    assert picture[..., :3].sum() == 21 and (picture[..., 3] == 1).all()
    assert np.array_equal(shown["Combined"][0, :, :3], values)
    assert np.array_equal(film.part(3, 2, 2, 1)["Combined"][0, :, :3], values)
    assert film.sample_total == film.counts.sum() == 2 + resumed
    assert film.counts.reshape(4, 5)[1, 1:3].tolist() == [1, 1]
    again = film.merge(Film.empty(Frame(8, 6, border=(2, 1, 7, 5))))
    assert np.array_equal(again.passes["Combined"], picture)


@pytest.mark.parametrize("exponents", [(-5, 5), (-60, 4), (-96, -20), (20, 31)])
def test_pictures_made_on_the_device_have_the_bits_of_the_sums(exponents):
    rng = np.random.default_rng(3)
    digits = rng.integers(-(2**62), 2**62, (WINDOW_DIGITS, 300)) >> rng.integers(0, 62, (WINDOW_DIGITS, 300))
    digits[-1] >>= 32
    values = np.ldexp(rng.standard_normal((40, 300)), rng.integers(*exponents, (40, 300))).astype(np.float32)
    for window in (digits, summed(values).window):
        tile = black_tile(100)
        tile.window.assign(window)
        tile.counts.assign(rng.integers(0, 50, 100))
        done = FinishedTile((0, 0, 10, 10), tile, layout_of(("Combined",), False), ("Combined",), 0)
        film = Film.empty(Frame(10, 10))
        film.add_tile(done)
        expected = film.merge(Film.empty(Frame(10, 10))).passes["Combined"]
        assert np.array_equal(done.passes["Combined"].view(np.int32), expected.view(np.int32))


def test_npz_holds_the_passes(tmp_path):
    film = Film.empty(Frame(3, 2, passes=("Combined", "Depth")))
    film.save_npz(tmp_path / "film.npz")
    with np.load(tmp_path / "film.npz") as arrays:
        assert {name: arrays[name].shape for name in arrays} == {"Combined": (2, 3, 4), "Depth": (2, 3, 1)}
        assert all(arrays[name].dtype == np.float32 for name in arrays)


def test_finished_tiles_keep_no_array_of_their_worker_and_stay_until_they_are_fetched(monkeypatch):
    tile = finished(0, 0, np.array([[1, 2, 3], [4, 5, 6]]))
    assert tile.film.spill_index.size == tile.film.spill_value.size == 0
    film = Film.empty(Frame(2, 1))
    film.add_tile(tile)
    with monkeypatch.context() as broken:
        broken.setattr(FinishedTile, "fetch", lambda self: (_ for _ in ()).throw(MemoryError()))
        with pytest.raises(MemoryError):
            _ = film.counts
    assert film.counts.tolist() == [1, 1]


def test_tiles_of_a_transparent_film_leave_the_rest_empty():
    layout = layout_of(("Combined",), True)
    tile = film_tiles(transparent=True).begin(1)
    window = np.zeros((WINDOW_DIGITS, 4), np.int64)
    window[-1] = [1, 2, 3, 1]
    tile.window.assign(window)
    tile.counts.fill_(1)
    film = Film.empty(Frame(3, 2, transparent=True))
    film.add_tile(FinishedTile((1, 0, 1, 1), tile, layout, ("Combined",), 1))
    picture = film.passes["Combined"]
    assert picture[0, 1].tolist() == [1, 2, 3, 1] and picture.sum() == 7
    assert np.array_equal(film.merge(Film.empty(Frame(3, 2, transparent=True))).passes["Combined"], picture)


def test_a_first_sample_is_of_one_pixel_whole():
    """Where both have a pixel's first sample, none of its channels is taken from the other."""

    def position(values):
        made = HostSamples.zeros(2, 4, ("Position",))
        return dataclasses.replace(made, first={"Position": np.array(values, np.float32)})

    merged = position([0, 2, 3, 0, 0, 0]).add(position([5, 2.1, 3.1, 0, 1, 0]))
    assert merged.first["Position"].tolist() == [0, 2, 3, 0, 1, 0]
