"""Launches that are made again and again do what single ones do, whatever changes between."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.device.launches import RepeatedLaunches


@wp.struct
class Rule:
    """What is added, and where that is reported."""

    amount: int
    reported: wp.array(dtype=int)


@wp.kernel(**KERNEL_OPTIONS)
def add_kernel(rule: Rule, factor: float, values: wp.array(dtype=float)):
    """By value."""
    i = wp.tid()
    values[i] = factor * values[i] + float(rule.amount)
    rule.reported[i] = rule.amount


@pytest.fixture
def rule(device):
    """With room for ten values."""
    made = Rule()
    made.amount, made.reported = 1, wp.zeros(10, dtype=int, device=device)
    return made


def test_what_changed_is_launched(device, rule):
    launches = RepeatedLaunches(wp.get_device(device))
    first, second = (wp.full(10, value, dtype=float, device=device) for value in (1.0, 2.0))
    launches.launch(add_kernel, 10, rule, 2.0, first)
    assert (first.numpy() == 3).all()
    launches.launch(add_kernel, 10, rule, 2.0, first)  # nothing changed
    assert (first.numpy() == 7).all()
    launches.launch(add_kernel, 4, rule, 3.0, second)  # another count, number and array
    assert (second.numpy() == np.where(np.arange(10) < 4, 7, 2)).all() and (first.numpy() == 7).all()
    rule.amount, before, rule.reported = 5, rule.reported, wp.zeros(10, dtype=int, device=device)
    launches.launch(add_kernel, 5, rule, 3.0, second[2:7])  # a struct that was changed in place, and a part of an array
    assert second.numpy().tolist() == [7, 7, 26, 26, 11, 11, 11, 2, 2, 2]
    assert (rule.reported.numpy()[:5] == 5).all() and (before.numpy() == 1).all()


def test_no_thread_is_no_launch(device, rule):
    launches = RepeatedLaunches(wp.get_device(device))
    values = wp.ones(10, dtype=float, device=device)
    launches.launch(add_kernel, 0, rule, 2.0, values)
    launches.launch(add_kernel, 1, rule, 2.0, values)
    launches.launch(add_kernel, 0, rule, 2.0, values)
    assert values.numpy().tolist() == [3.0] + [1.0] * 9


def test_another_struct_takes_the_place_of_the_last(device, rule):
    launches = RepeatedLaunches(wp.get_device(device))
    values = wp.zeros(2, dtype=float, device=device)
    launches.launch(add_kernel, 2, rule, 1.0, values)
    other = Rule()
    other.amount, other.reported = 10, rule.reported
    launches.launch(add_kernel, 2, other, 1.0, values)
    launches.launch(add_kernel, 2, rule, 1.0, values)
    assert values.numpy().tolist() == [12.0, 12.0]
