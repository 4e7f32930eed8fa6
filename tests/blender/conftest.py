"""Fixtures of Blender's tests, which are skipped as a whole where bpy cannot be imported."""

import importlib.util
import sys

import pytest

from raybatch_addon.core.wavefront.tier import VARIABLE

HAS_BPY = importlib.util.find_spec("bpy") is not None
collect_ignore_glob = [] if HAS_BPY else ["test_*.py"]


def pytest_report_header():
    """A line in the report when Blender's tests are left out."""
    return [] if HAS_BPY else ["Blender's tests are left out: bpy cannot be imported"]


@pytest.fixture(scope="package", autouse=True)
def general_kernels():
    """Renders are by general kernels: to compile specialised ones would take most of the time of these tests.

    Other tests render by specialised kernels, and tests/core/ahead compares the films of both.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, "GENERAL")
        yield


@pytest.fixture(scope="session")
def addon():
    """The add-on, registered as by `import raybatch_addon; raybatch_addon.register()`."""
    import raybatch_addon

    raybatch_addon.register()
    yield raybatch_addon
    raybatch_addon.unregister()


@pytest.fixture(scope="module")
def cycles(addon):
    """What nodes give in Cycles, those of Blender 5.2; opening another file ends it."""
    import bpy

    from tests.support.cycles_points import CyclesPoints

    if bpy.app.version < (5, 2):
        pytest.skip("the nodes are those of Blender 5.2")
    return CyclesPoints()


@pytest.fixture
def scene(addon):
    """An empty scene with factory settings, RayBatch as its engine, and nothing in it but a camera."""
    from tests.blender.features.compare import empty_scene

    scene = empty_scene()
    scene.render.resolution_x, scene.render.resolution_y = 32, 24
    scene.raybatch.sample_count = 2
    yield scene
    reports = sys.modules["raybatch_addon.blender.reports"]
    reports.clear()
