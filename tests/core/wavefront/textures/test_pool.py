"""Which tiles are in which slots."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.errors import OutOfMemoryError
from raybatch_addon.core.shading.images.image_upload import ImageCache
from raybatch_addon.core.shading.images.tiled.look_up import MARKS, PINNED, SEEN, WANTED
from raybatch_addon.core.shading.images.tiled.pictures import TiledImage
from raybatch_addon.core.wavefront.textures.carry import TileCarrier
from raybatch_addon.core.wavefront.textures.pool import TilePool, TileTotals, tile_slots_of


@pytest.fixture
def source():
    """One picture of 16 tiles, numbered 1 to 16; the texels of a tile are its number."""
    numbers = np.arange(1, 17, dtype=np.uint8).reshape(4, 4).repeat(16, 0).repeat(16, 1)
    image = TiledImage("numbers", np.repeat(numbers[..., None], 4, 2).copy(), slot_bytes=1024)
    return ImageCache().upload([image], wp.get_device("cpu")).tiled


def wanted(pool, **marks):
    """Bring tiles by their marks: `t3=(wanted, seen, pinned)`."""
    array = pool._marks.numpy().reshape(-1, MARKS)
    for name, values in marks.items():
        array[int(name[1:]), [WANTED, SEEN, PINNED]] = values
    pool.bring()
    assert not pool._marks.numpy().any()


def there(pool) -> dict[int, int]:
    """By tile the number that its slot shows, as kernels find it."""
    addresses = pool._on_device.numpy()
    found = {}
    for number in np.flatnonzero(addresses[1:]) + 1:
        slot = wp.array(ptr=int(addresses[number]), dtype=wp.uint8, shape=1024, device="cpu").numpy()
        assert (slot == slot[0]).all()
        found[int(number)] = int(slot[0])
    return found


def test_what_has_room_is_all_brought(source):
    pool = TilePool(source, 4)
    wanted(pool, t3=(1, 0, 0), t9=(5, 0, 0), t16=(1, 0, 0))
    assert there(pool) == {3: 3, 9: 9, 16: 16}
    assert (pool.totals.fetched, pool.totals.evicted, pool.totals.bytes) == (3, 0, 3 * 1024)


def test_the_tile_leaves_that_was_read_the_longest_time_ago(source):
    pool = TilePool(source, 3)
    wanted(pool, t1=(1, 0, 0), t2=(1, 0, 0), t3=(1, 0, 0))
    wanted(pool, t1=(0, 1, 0), t3=(0, 1, 0), t4=(1, 0, 0))
    assert there(pool) == {1: 1, 3: 3, 4: 4}
    pool.begin()  # another render, which goes on from there
    wanted(pool, t3=(0, 1, 0), t5=(2, 0, 0))
    assert there(pool).keys() == {3, 4, 5}


def test_where_room_lacks_the_next_rays_tiles_come_first_and_then_what_most_want(source):
    pool = TilePool(source, 3)
    wanted(pool, t1=(9, 0, 0), t2=(1, 0, 1), t3=(8, 0, 0), t4=(7, 0, 0), t5=(1, 0, 1))
    assert there(pool) == {1: 1, 2: 2, 5: 5}
    # what waiting rays want stays, though it was not read
    wanted(pool, t5=(1, 0, 1), t2=(1, 0, 0), t7=(5, 0, 0))
    assert there(pool) == {2: 2, 5: 5, 7: 7}


def test_beside_a_turn_tiles_leave_at_once_and_are_shown_when_they_are_there(source):
    pool = TilePool(source, 4)
    pool._carrier, pool._most = TileCarrier(source, 2), 2  # as on a GPU
    wanted(pool, t1=(1, 0, 0), t2=(2, 0, 0), t3=(3, 0, 0))
    assert not there(pool) and pool.totals.fetched == 2, "half of the slots at a time"
    wanted(pool, t1=(1, 0, 0), t2=(1, 0, 0), t3=(1, 0, 0))
    assert there(pool) == {2: 2, 3: 3}
    wanted(pool, t2=(0, 1, 0), t4=(1, 0, 0), t5=(1, 0, 0))
    assert there(pool) == {1: 1, 2: 2}, "the oldest left before its slot was written"
    wanted(pool, t4=(1, 0, 0), t5=(1, 0, 0), t6=(1, 0, 1))
    assert there(pool).items() >= {4: 4, 5: 5}.items() and 6 not in there(pool)
    wanted(pool, t6=(1, 0, 1))
    assert there(pool)[6] == 6 and pool.totals.fetched == 6


def test_look_ups_of_tiles_that_are_not_there_are_counted(source):
    pool = TilePool(source, 2)
    wanted(pool, t0=(3, 0, 0), t1=(1, 0, 0))
    assert pool.count().lost == 3 and there(pool) == {1: 1}
    assert "3 look-ups" in pool.totals.warnings()[0] and not TileTotals().warnings()
    pool.begin()
    assert pool.count() == TileTotals(tiles=16, slots=2, slot_bytes=1024) and there(pool) == {1: 1}


def test_a_pool_has_no_more_slots_than_tiles_and_enough_for_a_path(source):
    assert tile_slots_of(source, 1 << 30, 500, 3, 9) == 16
    assert tile_slots_of(source, 500 + 3 * 9 * 1024, 500, 3, 9) == 9
    with pytest.raises(OutOfMemoryError, match=r"texture_budget .* needs 28,148 at least"):
        tile_slots_of(source, 499 + 3 * 9 * 1024, 500, 3, 9)
    assert tile_slots_of(source, 16 * 1024, 0, 1, 99) == 16  # all there is


def test_totals_of_workers_are_one_report():
    both = TileTotals(tiles=16, slots=2, slot_bytes=1024, looked=6, waited=3).merge(
        TileTotals(tiles=16, slots=3, slot_bytes=1024, looked=4, fetched=1)
    )
    reported = both.report()
    assert (reported["tiles"], reported["slots"], reported["looked"], reported["waited_share"]) == (16, 5, 10, 0.3)
