"""Frozen arrays: what cannot be written, what is known of it, and whether it is the same."""

import gc

import numpy as np
import pytest

from raybatch_addon.core.scene import frozen
from raybatch_addon.core.scene.frozen import Same, fact, freeze, is_frozen


def test_a_view_is_frozen_with_what_it_is_a_view_of():
    whole = np.zeros(6, np.float32)
    view = freeze(whole.reshape(2, 3))
    assert is_frozen(view) and is_frozen(whole)
    with pytest.raises(ValueError, match="read-only"):
        whole[0] = 1
    open_view = np.zeros(6, np.float32).reshape(2, 3)
    open_view.flags.writeable = False
    assert not is_frozen(open_view), "it changes with the array below"
    assert not is_frozen(np.frombuffer(bytes(8), np.float32)), "memory of others"


def test_facts_of_frozen_arrays_are_computed_once_and_end_with_them():
    asked = []

    def total(array):
        asked.append(1)
        return float(array.sum())

    array = np.arange(4.0)
    assert [fact(array, total), fact(array, total)] == [6, 6] and len(asked) == 2
    array[0] = 1
    assert fact(array, total) == 7, "an array that may change is looked at anew"
    asked.clear()
    freeze(array)
    assert [fact(array, total), fact(array, total)] == [7, 7] and len(asked) == 1
    gc.collect()  # what other tests left
    before = len(frozen._facts)
    del array
    gc.collect()
    assert len(frozen._facts) == before - 1


def test_facts_of_several_arrays_are_of_all_of_them():
    asked = []

    def product(array, other):
        asked.append(1)
        return float(array @ other)

    array, other, loose = freeze(np.arange(3.0)), freeze(np.ones(3)), np.ones(3)
    assert [fact(array, product, other), fact(array, product, other)] == [3, 3] and len(asked) == 1
    assert fact(array, product, freeze(2 * np.ones(3))) == 6
    for factor in (1, 2):
        loose[:] = factor
        assert fact(array, product, loose) == 3 * factor
    gc.collect()
    before = len(frozen._facts)
    del other
    gc.collect()
    assert len(frozen._facts) == before - 1


def test_the_same_is_the_same_frozen_object():
    array, twin = freeze(np.arange(3)), freeze(np.arange(3))
    same = Same([array, None], ("a", 1))
    assert same.holds([array, None], ("a", 1))
    assert not same.holds([twin, None], ("a", 1)), "equal is not the same"
    assert not same.holds([array, None], ("a", 2))
    assert not same.holds([array], ("a", 1))
    assert not same.holds([array, array], ("a", 1))
    array.flags.writeable = True
    assert not same.holds([array, None], ("a", 1)), "it may have been written"
