"""Tiles are dealt in order, first those that lie where the worker is, but for one that takes longer elsewhere."""

from math import inf

from raybatch_addon.core.wavefront.render.deal import Deal


def test_a_worker_takes_its_own_tiles_and_new_ones_then_those_of_others():
    deal = Deal(
        (tile, place, inf) for tile, place in zip("abcde", ("here", "there", None, "there", "here"), strict=True)
    )
    assert [deal.take("there") for _ in range(6)] == ["b", "c", "d", "a", "e", None]


def test_what_is_put_back_comes_behind_the_others_and_stays_where_it_was_rendered():
    deal = Deal([("a", None, inf), ("b", None, inf)])
    first = deal.take("here")
    deal.put_back(first, "here")
    assert (first, deal.take("here"), deal.take("there")) == ("a", "b", "a")
    deal.put_back("a", "there")
    deal.put_back("b", "here")
    assert (deal.take("here"), deal.take("here"), deal.take("here")) == ("b", "a", None)


def test_what_takes_longest_is_taken_first_wherever_it_is():
    deal = Deal([("new", None, inf), ("shortest", "here", 0.5)])
    deal.put_back("short", "here", 1.0)
    deal.put_back("long", "there", 10.0)
    deal.put_back("half as long", "here", 5.5)
    assert [deal.take("here") for _ in range(5)] == ["new", "half as long", "long", "short", "shortest"]
