"""For tests of live renders: who lends them a session, and requests."""

import threading
import time
from contextlib import contextmanager
from dataclasses import replace

from raybatch_addon.core.live.picture import LiveRequest
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support.scenes import mixed

SECONDS = 120.0  # a test waits for this at most: kernels may have to be compiled


class Source:
    """Lends one session, and can want it back."""

    def __init__(self, session):
        self.opened, self.wanted, self.lent = session, False, 0
        self.free = threading.Event()
        self.free.set()

    @contextmanager
    def session(self, request, given_up):
        while not self.free.is_set() and not given_up():
            time.sleep(0.005)
        self.lent += 1
        yield self.opened if self.free.is_set() else None

    def is_wanted(self, has_shown):
        return self.wanted


def request(number, samples=8, side=1, size=(48, 40), **changes):
    scene = replace(mixed(Frame(*size)), **changes)
    return LiveRequest(number, scene, RenderSettings(sample_count=samples), side)


def wait_for(condition):
    end = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < end, "nothing came"
        time.sleep(0.002)
