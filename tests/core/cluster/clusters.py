"""What tests of clusters share."""

import contextlib
import os
import time

import pytest

from raybatch_addon.core.cluster import bands, ranges
from raybatch_addon.core.cluster.local import local_cluster
from raybatch_addon.core.cluster.ranges import SampleRange
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support.watched_renders import FRAME

SETTINGS = RenderSettings(sample_count=48, bounce_max=5)


def dealing(count):
    """A `RangeDeal.next` of `count` samples a task."""

    def dealt(self, workers):
        if self.is_dealt:
            return None
        if self._band == self.bands:
            self._begin_layer(workers)
        samples = SampleRange(self._next, min(self._next + count, self._layer[1]), self._band)
        self._next = samples.end
        if self._next == self._layer[1]:
            self._band, self._next = self._band + 1, self._layer[0]
        return samples

    return dealt


def cut_into(count, monkeypatch):
    """Frames of these tests have so many bands, which is returned, and layers of few samples."""
    monkeypatch.setattr(ranges, "LAYER_SECONDS", 0.1)
    monkeypatch.setattr(ranges, "TASK_TIMES_FILM", 0.0)
    monkeypatch.setattr(bands, "BAND_PIXELS", FRAME.width * FRAME.height / count)
    assert len(bands.bands_of(FRAME.region)) == count
    return count


@contextlib.contextmanager
def two_workers(folder):
    """The address of a scheduler with two workers on this machine, which come back when they are killed; their parts
    lie in `folder`.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAYBATCH_PART_FOLDER", str(folder))
        with local_cluster(2, os.environ.get("RAYBATCH_KERNEL_CACHE")) as address:
            yield address


def wait_for(condition, seconds=60.0):
    """Until `condition()`."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.05)
