"""What tests of clusters share."""

import time

import numpy as np

from raybatch_addon.core.cluster.ranges import SampleRange
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support.watched_renders import assert_same

SETTINGS = RenderSettings(sample_count=48, bounce_max=5)


def dealt_evenly(self, workers):
    """As `RangeDeal.next`: two samples a task."""
    if self.is_dealt:
        return None
    samples = SampleRange(self._next, min(self._next + 2, self.end))
    self._next = samples.end
    return samples


def wait_for(condition, seconds=60.0):
    """Until `condition()`."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.05)


def assert_same_film(film, expected):
    """Bit for bit, with the same samples of each pixel, and the same halves."""
    assert film.complete
    assert np.array_equal(film.counts, expected.counts)
    assert_same(film.passes, expected.passes)
    for mine, theirs in zip(film.halves or (), expected.halves or (), strict=True):
        assert_same(mine.passes, theirs.passes)
