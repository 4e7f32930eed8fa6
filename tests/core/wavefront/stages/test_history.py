"""How a path has scattered so far, in one word."""

import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.programs.point import DEPTH_BITS, DEPTH_SHIFT, HistoryBits
from raybatch_addon.core.shading.bsdf.materials import DELTA, DIFFUSE, GLOSSY, TRANSMISSION
from raybatch_addon.core.wavefront.stages.surface.history import DEPTHS, history_after
from tests.support.under_test import DEVICE


@wp.kernel(**KERNEL_OPTIONS)
def probe(lobes: wp.array(dtype=int), out: wp.array(dtype=int)):
    history = int(0)
    for i in range(lobes.shape[0]):
        history = history_after(history, lobes[i])
    out[0] = history


def after(*lobes: int) -> int:
    out = wp.zeros(1, dtype=int, device=DEVICE)
    wp.launch(probe, 1, [wp.array(lobes, dtype=int, device=DEVICE), out], device=DEVICE)
    return int(out.numpy()[0])


def depths(history: int) -> list[int]:
    return [history >> DEPTH_SHIFT + DEPTH_BITS * k & (1 << DEPTH_BITS) - 1 for k in range(3)]


@pytest.mark.parametrize(
    "lobe, kind, depth",
    [
        (DIFFUSE, HistoryBits.DIFFUSE, [1, 0, 0]),
        (GLOSSY, HistoryBits.GLOSSY, [0, 1, 0]),
        (GLOSSY | DELTA, HistoryBits.GLOSSY | HistoryBits.SINGULAR, [0, 1, 0]),
        (TRANSMISSION, HistoryBits.GLOSSY, [0, 0, 1]),
        (TRANSMISSION | DELTA, HistoryBits.GLOSSY | HistoryBits.SINGULAR, [0, 0, 1]),
        (DIFFUSE | TRANSMISSION, HistoryBits.DIFFUSE, [0, 0, 1]),
    ],
)
def test_one_scattering(lobe, kind, depth):
    history = after(lobe)
    assert history & ~DEPTHS == kind and depths(history) == depth


def test_kinds_are_those_of_the_last_and_counts_of_all():
    history = after(DIFFUSE, GLOSSY | DELTA, TRANSMISSION, DIFFUSE)
    assert history & ~DEPTHS == HistoryBits.DIFFUSE and depths(history) == [2, 1, 1]


def test_counts_stay_at_their_largest():
    most = (1 << DEPTH_BITS) - 1
    assert depths(after(*[TRANSMISSION] * (most + 5), *[GLOSSY] * 3)) == [0, 3, most]
    assert after(*[DIFFUSE] * (most + 5)) >= 0
