"""What all tests share: the device they run on."""

import pytest


def pytest_addoption(parser):
    parser.addoption("--device", default="cpu", help="device for the tests of the core: cpu (default) or cuda:0")


@pytest.fixture(scope="session")
def device(request) -> str:
    """Alias of the device under test."""
    return request.config.getoption("--device")


@pytest.fixture(scope="module")
def session(device):
    """A session on the device under test."""
    from raybatch_addon.core.session import Session

    opened = Session(device)
    yield opened
    opened.close()
