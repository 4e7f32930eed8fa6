"""Tiles are dealt in order, first those that lie where the worker is."""

from raybatch_addon.core.wavefront.render.deal import Deal


def test_a_worker_takes_its_own_tiles_and_new_ones_then_those_of_others():
    deal = Deal([("a", "here"), ("b", "there"), ("c", None), ("d", "there"), ("e", "here")])
    assert [deal.take("there") for _ in range(6)] == ["b", "c", "d", "a", "e", None]


def test_what_is_put_back_comes_behind_the_others_and_stays_where_it_was_rendered():
    deal = Deal([("a", None), ("b", None)])
    first = deal.take("here")
    deal.put_back(first, "here")
    assert (first, deal.take("here"), deal.take("there")) == ("a", "b", "a")
    deal.put_back("a", "there")
    deal.put_back("b", "here")
    assert (deal.take("here"), deal.take("here"), deal.take("here")) == ("b", "a", None)
