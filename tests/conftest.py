"""What all tests share: the device they run on."""

import pytest
from under_test import DEVICE


@pytest.fixture(scope="session")
def device() -> str:
    """Alias of the device under test."""
    return DEVICE


@pytest.fixture(scope="module")
def session(device):
    """A session on the device under test."""
    from raybatch_addon.core.session import Session

    opened = Session(device)
    yield opened
    opened.close()
