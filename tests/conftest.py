"""What all tests share: the device they run on."""

import os
from pathlib import Path

import pytest
from under_test import DEVICE

# Compiled kernels stay in the clone, for this run's subprocesses and the next run alike
_KERNELS = Path(__file__).resolve().parents[1] / ".cache" / "kernels"
os.environ.setdefault("WARP_CACHE_PATH", str(_KERNELS))
os.environ.setdefault("RAYBATCH_KERNEL_CACHE", str(_KERNELS))


@pytest.fixture(scope="session")
def device() -> str:
    """Alias of the device under test."""
    return DEVICE


@pytest.fixture(scope="module")
def session(device, tmp_path_factory):
    """A session on the device under test, with a folder of its own for pages of geometry."""
    from raybatch_addon.core.session import Session

    opened = Session(device, page_folder=tmp_path_factory.mktemp("pages"))
    yield opened
    opened.close()


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem):
    """Tests that compile for the CPU are skipped on machines whose Warp has no compiler for it."""
    try:
        return (yield)
    except Exception as error:
        if "wp_compile_cpp" in str(error):
            pytest.skip("this machine cannot compile kernels for the CPU")
        raise
