"""A cluster of two processes on this machine."""

import pytest

pytest.importorskip("distributed")

from raybatch_addon.core.cluster.connection import Connection
from raybatch_addon.core.cluster.ranges import RangeDeal
from tests.core.cluster.clusters import SETTINGS, cut_into, dealing, two_workers, wait_for
from tests.support import scenes
from tests.support.running.shares import thorough_but
from tests.support.watched_renders import FRAME


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """A scheduler with two workers on this machine, which come back when they are killed."""
    with two_workers(tmp_path_factory.mktemp("parts")) as found:
        yield found


@pytest.fixture
def connection(address):
    """A connection to it, with both workers there."""
    made = Connection(address)
    wait_for(lambda: len(made.workers()) == 2)
    yield made
    made.close()


@pytest.fixture(scope="module")
def expected(session):
    """The film of one process."""
    return session.render(scenes.mixed(FRAME), SETTINGS)


@pytest.fixture
def bands(monkeypatch):
    """Frames are cut into three bands."""
    return cut_into(3, monkeypatch)


@pytest.fixture(params=thorough_but([3], [1, 3]))  # tests without it have whole frames
def cut(request, monkeypatch):
    """The number of bands into which frames are cut."""
    return cut_into(request.param, monkeypatch)


@pytest.fixture
def long_tasks(monkeypatch):
    """Every range takes as long as it would in a larger picture, and there are some twenty of them."""
    monkeypatch.setattr(RangeDeal, "next", dealing(2))
