"""Sessions with a folder for pages, and the films of whole scenes."""

from pathlib import Path

import pytest
from checking.films import FilmComparer

from raybatch_addon.core.session import Session
from tests.renders.beyond_memory.least_budget import ESTIMATOR
from tests.support import schedule_scenes


@pytest.fixture
def pages(tmp_path) -> Path:
    return tmp_path / "pages"


@pytest.fixture
def session(device, pages):
    opened = Session(device, page_folder=pages)
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def plain(device):
    """Films without queues, of all scenes."""
    opened = Session(device)
    made = {name: FilmComparer(opened, make(), ESTIMATOR, 24) for name, make in schedule_scenes.SCENES.items()}
    yield made
    opened.close()
