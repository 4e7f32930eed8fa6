"""The policy of tiles and rays, without a device."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.scheduler import (
    IMAGE_RAYS,
    RAYS_MOST,
    WaterMarks,
    paths_a_worker,
    reduced_path_count,
    tile_edge,
    tiles,
    water_marks,
)


@given(st.integers(0, 50), st.integers(0, 50), st.integers(1, 90), st.integers(1, 90), st.integers(1, 40))
def test_tiles_cover_a_region_exactly_once(x0, y0, width, height, edge):
    covered = np.zeros((200, 200), int)
    for tile in tiles((x0, y0, x0 + width, y0 + height), edge):
        assert 1 <= tile.width <= edge and 1 <= tile.height <= edge
        covered[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width] += 1
    assert covered.sum() == width * height and covered[y0 : y0 + height, x0 : x0 + width].min() == 1


@pytest.mark.parametrize("is_cuda", [False, True])
@pytest.mark.parametrize("size", [(2, 2), (32, 24), (1920, 1080), (5000, 3)])
def test_a_frame_that_can_be_cut_is_shown_in_four_tiles_at_least(is_cuda, size):
    edge = tile_edge(RenderSettings(sample_count=1 << 24), is_cuda, *size)
    assert len(list(tiles((0, 0, *size), edge))) >= 4
    assert tile_edge(RenderSettings(tile_size=77), is_cuda, *size) == 77


def test_next_to_no_paths_are_one_tile_on_a_cpu():
    def count(samples, *size):
        return len(list(tiles((0, 0, *size), tile_edge(RenderSettings(sample_count=samples), False, *size))))

    assert count(1, 16, 16) == 1 and count(1, 16, 9) == 1
    assert count(2, 16, 16) == 4 and count(1, 160, 90) > 4


def test_little_work_is_one_tile_on_a_gpu_and_long_work_comes_in_many():
    assert len(list(tiles((0, 0, 1280, 1280), tile_edge(RenderSettings(sample_count=2), True, 1280, 1280)))) == 1
    assert len(list(tiles((0, 0, 1280, 1280), tile_edge(RenderSettings(sample_count=4096), True, 1280, 1280)))) == 25


@given(st.integers(1, 10_000), st.floats(0, 1), st.floats(0, 1), st.integers(0, 10_000), st.integers(0, 10_000))
def test_rays_stay_between_the_water_marks_and_never_run_dry(count, a, b, alive, remaining):
    low, high = sorted((a, b))
    marks = water_marks(RenderSettings(ray_low_water=low, ray_high_water=high), count)
    assert 1 <= marks.low <= marks.high <= count
    alive = min(alive, marks.high)
    new = marks.to_generate(alive, remaining)
    assert 0 <= new <= remaining and alive + new <= marks.high
    if alive == 0 and remaining:
        assert new > 0
    if alive >= marks.low:
        assert new == 0


def test_marks_below_the_low_water_fill_to_the_high():
    assert WaterMarks(100, 50, 80).to_generate(49, 1000) == 31
    assert WaterMarks(100, 50, 80).to_generate(50, 1000) == 0


def test_ray_count_is_shared_by_the_workers():
    assert paths_a_worker(RenderSettings(ray_count=1000), 4, False) == 250
    assert paths_a_worker(RenderSettings(ray_count=1), 4, False) == 1
    assert paths_a_worker(RenderSettings(ray_count=1000), 1, True, True, True) == 1000
    assert paths_a_worker(RenderSettings(), 1, True, True) == RAYS_MOST[True]
    assert paths_a_worker(RenderSettings(), 1, True, True, True) == IMAGE_RAYS


def test_what_comes_to_a_gpu_serves_more_rays_and_larger_tiles():
    settings = RenderSettings(sample_count=256)
    assert paths_a_worker(settings, 1, True, many=True) > paths_a_worker(settings, 1, True)
    assert tile_edge(settings, True, 1280, 720, many=True) == 1280 > tile_edge(settings, True, 1280, 720)


def test_path_count_shrinks_to_memory():
    assert reduced_path_count(1024, 100, 1 << 30) == 1024
    assert reduced_path_count(1024, 100, 30_000) == 256
    assert reduced_path_count(1024, 100, 99) == 0
