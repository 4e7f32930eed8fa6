"""Which pixels end, against a twin in NumPy, and lists of those that go on."""

import itertools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.wavefront.adaptive.active_pixels import ActivePixels, HalfPictures
from raybatch_addon.core.wavefront.adaptive.noise import RADIUS
from raybatch_addon.core.wavefront.scheduler import Rectangle, tiles
from raybatch_addon.core.wavefront.stages.generate import pixel_in_blocks
from tests.support.under_test import DEVICE

REGION = (5, 3, 28, 20)
WIDTH, HEIGHT = 23, 17


def sample_noise(first: np.ndarray, second: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """The noise of samples, like that of the kernel of this name, in float64."""
    difference = np.abs(first - second)[..., :3].sum(-1)
    light = (first + second)[..., :3].sum(-1) / 2
    ratio = np.divide(difference / 2, light, out=np.zeros_like(light), where=difference > 0)
    alpha = (first - second)[..., 3] / 2
    return (ratio**2 * np.minimum(light, 1.0) + alpha**2) * counts


def around(noise: np.ndarray) -> np.ndarray:
    """The mean over the neighbours of each pixel, pixel by pixel."""
    found = np.full(noise.shape, np.inf)
    for y, x in itertools.product(range(noise.shape[0]), range(noise.shape[1])):
        window = np.s_[max(y - RADIUS, 0) : y + RADIUS + 1, max(x - RADIUS, 0) : x + RADIUS + 1]
        others = np.ones_like(noise[window], bool)
        others[min(y, RADIUS), min(x, RADIUS)] = False
        if others.any():
            found[y, x] = noise[window][others].mean()
    return found


def halves(random, height=HEIGHT, width=WIDTH):
    """Two pictures whose noise grows to the right, some black pixels, and counts."""
    light = random.uniform(0.0, 2.0, (height, width, 1))
    light[:, : width // 4] = 0
    noise = np.linspace(0, 1, width)[None, :, None] * random.uniform(-0.3, 0.3, (2, height, width, 3))
    pictures = np.zeros((2, height, width, 4), np.float32)
    pictures[..., :3] = light * (1 + noise)
    return pictures, random.integers(1, 9, (height, width)) * 8


def look(active: ActivePixels, pictures, counts, samples, edge):
    """A look, with the pictures in tiles of `edge` pixels."""
    x0, y0 = active.region[:2]

    def cut(values, tile, dtype):
        rows = values[tile.y - y0 : tile.y - y0 + tile.height, tile.x - x0 : tile.x - x0 + tile.width]
        return wp.array(rows.reshape(tile.pixel_count, *values.shape[2:]), dtype=dtype, device=DEVICE)

    parts = [
        HalfPictures(
            tile,
            tuple(cut(picture, tile, wp.vec4) for picture in pictures),
            tuple(cut(counts // 2, tile, wp.int64) for _ in range(2)),
        )
        for tile in tiles(active.region, edge)
    ]
    active.look(parts, samples, wp.get_device(DEVICE))


@pytest.mark.parametrize("edge", [64, 5])
def test_pixels_end_by_the_noise_of_their_neighbours_in_any_tiles(edge):
    pictures, counts = halves(np.random.default_rng(3))
    active = ActivePixels.all_of(REGION, 0.05)
    look(active, pictures, counts, 64, edge)
    found = around(sample_noise(*pictures.astype(float), counts)) / 64
    clear = np.abs(found / 0.05**2 - 1) > 1e-4  # float32 may decide the rest otherwise
    assert clear.mean() > 0.99 and 0.2 < (active.stopped > 0).mean() < 0.8
    assert np.array_equal((active.stopped == 64)[clear], (found < 0.05**2)[clear])
    assert active.looks == [{"samples": 64, "pixels": int((active.stopped == 0).sum())}]
    assert active.share == pytest.approx((active.stopped == 0).mean())
    # a second look ends more, and leaves those alone that had ended
    before = active.stopped.copy()
    look(active, pictures, counts, 128, edge)
    assert np.array_equal(active.stopped[before > 0], before[before > 0])
    assert set(np.unique(active.stopped)) == {0, 64, 128}
    assert np.array_equal(active.counts(128), np.where(active.stopped, active.stopped, 128))


def test_alpha_is_looked_at_where_it_differs():
    pictures = np.full((2, HEIGHT, WIDTH, 4), 0.5, np.float32)
    pictures[0, :, :5, 3] = 0.52
    active = ActivePixels.all_of(REGION, 0.009)
    look(active, pictures, np.full((HEIGHT, WIDTH), 64), 64, 5)
    assert (active.stopped[:, : 5 - RADIUS] == 0).all() and (active.stopped[:, 5 + RADIUS :] == 64).all()


def test_light_beyond_what_can_be_summed_ends_as_any_other():
    pictures = np.full((2, HEIGHT, WIDTH, 4), 3e38, np.float32)
    pictures[1, ..., :3] = 1e38
    for threshold, ended in ((0.4, 0), (0.6, 64)):  # a ratio of 0.5: all sums are at their bound
        active = ActivePixels.all_of(REGION, threshold)
        look(active, pictures, np.full((HEIGHT, WIDTH), 64), 64, 64)
        assert (active.stopped == ended).all()


def test_a_pixel_has_no_part_in_its_own_end():
    pictures = np.full((2, HEIGHT, WIDTH, 4), 0.5, np.float32)
    pictures[0, 8, 11, :3] = 500.0
    active = ActivePixels.all_of(REGION, 0.01)
    look(active, pictures, np.full((HEIGHT, WIDTH), 64), 64, 64)
    goes_on = active.stopped == 0
    assert not goes_on[8, 11]
    y, x = np.nonzero(goes_on)
    assert goes_on.sum() == (2 * RADIUS + 1) ** 2 - 1
    assert np.abs(y - 8).max() == RADIUS == np.abs(x - 11).max()


def test_what_is_no_number_goes_on_and_so_does_a_pixel_alone():
    pictures = np.zeros((2, HEIGHT, WIDTH, 4), np.float32)
    pictures[0, 0, 0, :3] = np.nan
    active = ActivePixels.all_of(REGION, 1.0)
    look(active, pictures, np.full((HEIGHT, WIDTH), 64), 64, 64)
    assert (active.stopped == 0).sum() == (RADIUS + 1) ** 2 - 1
    alone = ActivePixels.all_of((4, 4, 5, 5), 1.0)
    look(alone, np.zeros((2, 1, 1, 4), np.float32), np.full((1, 1), 64), 64, 64)
    assert alone.stopped[0, 0] == 0


def test_a_threshold_of_0_ends_nothing():
    active = ActivePixels.all_of(REGION, 0.0)
    look(active, np.zeros((2, HEIGHT, WIDTH, 4), np.float32), np.full((HEIGHT, WIDTH), 64), 64, 64)
    assert not active.stopped.any()


@pytest.mark.parametrize("edge", [64, 9, 1])
def test_lists_name_the_active_pixels_in_the_order_of_their_walk(edge):
    active = ActivePixels.all_of(REGION, 0.01)
    random = np.random.default_rng(5)
    active.stopped[:] = np.where(random.random((HEIGHT, WIDTH)) < 0.6, 64, 0)
    active.stopped[-9:, :9] = 0  # of a tile all pixels
    active.stopped[-9:, 9:18] = 64  # of one none
    rectangles = list(tiles(REGION, edge))
    lists = active.lists(rectangles, wp.get_device(DEVICE))
    listed = np.zeros((HEIGHT, WIDTH), bool)
    for tile, found in zip(rectangles, lists, strict=True):
        places = walk(tile)
        numbers = np.arange(tile.pixel_count) if found is None else found.numpy()
        assert (np.diff(numbers) > 0).all()
        listed[places[numbers, 1] + tile.y - 3, places[numbers, 0] + tile.x - 5] = True
    assert np.array_equal(listed, active.stopped == 0)
    if edge == 9:
        assert lists[0] is None and lists[1].size == 0


@wp.kernel(**KERNEL_OPTIONS)
def walk_kernel(width: int, height: int, result: wp.array(dtype=wp.vec2i)):
    result[wp.tid()] = pixel_in_blocks(wp.tid(), width, height)


def walk(tile: Rectangle) -> np.ndarray:
    result = wp.zeros(tile.pixel_count, dtype=wp.vec2i, device=DEVICE)
    wp.launch(walk_kernel, tile.pixel_count, [tile.width, tile.height, result], device=DEVICE)
    return result.numpy()


def test_a_copy_changes_apart():
    active = ActivePixels.all_of(REGION, 0.5)
    copy = active.copy()
    look(copy, np.zeros((2, HEIGHT, WIDTH, 4), np.float32), np.full((HEIGHT, WIDTH), 64), 64, 64)
    assert copy.share == 0.0 and active.share == 1.0 and not active.looks
