"""The parts that all tests share: the device they run on, compiled kernels, and their order."""

import os
from pathlib import Path

import pytest

from raybatch_addon.core.device.kernel import OPTIMISATION, SPECIALISED_CODE
from tests.support.running.file_seconds import file_seconds
from tests.support.running.kernel_builds import build_once
from tests.support.under_test import DEVICE

pytest_plugins = ["tests.support.running.run_seconds"]
FAST_SECONDS = 3.0  # a file of tests that takes less is among the fast ones
NO_CPU_COMPILER = "this machine cannot compile kernels for the CPU"
ALSO_FAST = ("test_architecture.py",)  # takes longer, but fails for what is easily mended

# Compiled kernels stay in the clone, for this run's subprocesses and the next run alike
_KERNELS = Path(__file__).resolve().parents[1] / ".cache" / "kernels"
os.environ.setdefault("WARP_CACHE_PATH", str(_KERNELS))
os.environ.setdefault("RAYBATCH_KERNEL_CACHE", str(_KERNELS))
# Which kernels render does not depend on what other tests compiled
os.environ.setdefault("RAYBATCH_KERNEL_TIER", "SPECIALISED")


def pytest_addoption(parser):
    parser.addoption("--fast", action="store_true", help="only the files of tests that take a few seconds")
    parser.addoption("--thorough", action="store_true", help="also tests marked `thorough`, as make test-all does")


def pytest_configure(config):
    if DEVICE == "cpu" and not config.option.thorough:
        os.environ.setdefault(SPECIALISED_CODE, "OUT_OF_LINE")  # specialised kernels compile in half the time
        os.environ.setdefault(OPTIMISATION, "1")  # all kernels in a fifth less
    config.addinivalue_line("markers", "thorough: takes a minute or more, and runs with --thorough alone")


def pytest_ignore_collect(collection_path, config):
    """Long files are left out where the fast ones are asked for."""
    is_tests = collection_path.name.startswith("test_") and collection_path.suffix == ".py"
    long = is_tests and file_seconds(collection_path) >= FAST_SECONDS and collection_path.name not in ALSO_FAST
    return True if long and config.option.fast else None


def pytest_collection_modifyitems(config, items):
    """Thorough tests run where they are asked for; side by side, the longest files come first, to end together."""
    if not config.option.thorough:
        left_out = [item for item in items if item.get_closest_marker("thorough")]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in set(left_out)]
    if config.getoption("dist", "no") != "no" or hasattr(config, "workerinput"):
        items.sort(key=lambda item: -file_seconds(item.path))  # stable: files stay whole


@pytest.fixture(scope="session", autouse=True)
def kernels_built_once():
    """Processes that run tests side by side wait for each other's kernels."""
    build_once()


@pytest.fixture(scope="session", autouse=True)
def skipped_without_cpu_compiler():
    """Tests that compile for the CPU end there, as skipped, on machines whose Warp has no compiler for it."""
    import warp as wp

    def compiled(*arguments, within=wp._src.build.build_cpu, **options):
        if wp._src.context.runtime.llvm is None:
            pytest.skip(NO_CPU_COMPILER)
        return within(*arguments, **options)

    wp._src.build.build_cpu = compiled


@pytest.fixture(scope="session")
def device() -> str:
    """Alias of the device under test."""
    return DEVICE


@pytest.fixture(scope="session")
def examples(pytestconfig):
    """`examples(number)`: how many to draw of the `number` that a thorough run draws: a third."""
    return lambda number: number if pytestconfig.option.thorough else -(-number // 3)


@pytest.fixture(scope="module")
def session(device, tmp_path_factory):
    """A session on the device under test, with a folder of its own for pages of geometry."""
    from raybatch_addon.core.session import Session

    opened = Session(device, page_folder=tmp_path_factory.mktemp("pages"))
    yield opened
    opened.close()


@pytest.fixture(scope="session")
def cpu_compiler():
    """For tests whose processes compile for the CPU: they are skipped where Warp has no compiler for it."""
    import warp as wp

    from raybatch_addon.core.device.devices import start_warp

    start_warp()
    if wp._src.context.runtime.llvm is None:
        pytest.skip(NO_CPU_COMPILER)


@pytest.fixture
def general_kernels():
    """Renders are by kernels that tests share: to compile specialised ones would take most of a test's time."""
    from tests.support.running.general_kernels import by_general_kernels

    with by_general_kernels():
        yield


@pytest.fixture(scope="module")
def general_kernels_of_module():
    """The same for all tests of a file, and for what they share."""
    from tests.support.running.general_kernels import by_general_kernels

    with by_general_kernels():
        yield
