"""No scene waits for a compiler before its first picture, where the kernels are there that an environment makes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.core.ahead.outside_general import SPECIALISED
from tests.support.feature_scenes import ALL_FEATURES, lit
from tests.support.running.general_kernels import put_general_kernels
from tests.support.under_test import DEVICE

ROOT = Path(__file__).resolve().parents[3]
# Compiled when it is asked for: what nobody renders with by default, and what few scenes have
NOT_AHEAD = {"Warp's tree", *SPECIALISED}
# Some features with what a user gets by default, and ways to trace that few ask for: scene and changes of `SETTINGS`
BY_DEFAULT = ("opaque, lit", "hidden from some rays", "everything", "transparent with a program", "volume", "fibres")
INSTANCES = ALL_FEATURES["hidden from some rays"][0]
SCHEDULES = {
    **{f"{name}, by default": (ALL_FEATURES[name][0], {"ray_sort": "AUTO", "sample_count": 4}) for name in BY_DEFAULT},
    "in queues": (lit(), {"batching": "ON"}),
    "beyond memory": (lit(), {"geometry_budget": 70_000}),
    "beyond memory, instances": (INSTANCES, {"geometry_budget": 70_000}),
    "counted": (lit(), {"counters": "ON"}),
    "counted, instances": (INSTANCES, {"counters": "ON"}),
}

# Renders all scenes with kernels of the folder sys.argv[1]; says what modules each compiled, and which were rendered by
# general kernels. What is not ahead is counted and not compiled, as by a session that is closed meanwhile.
PROCESS = """
import json, sys
import warp as wp
compile_module, compiled = wp.Module._compile, {}
def counted(module, *arguments, **options):
    compiled.setdefault(feature, []).append(module.name)
    if feature in NOT_AHEAD:
        raise CompileStoppedError
    return compile_module(module, *arguments, **options)
wp.Module._compile = counted
from raybatch_addon.core.device.compiler import CompileStoppedError
from raybatch_addon.core.session import Session
from tests.core.ahead.outside_general import SPECIALISED
from tests.core.ahead.test_no_waits import NOT_AHEAD, SCHEDULES
from tests.support.feature_scenes import ALL_FEATURES, SETTINGS
general = []
for feature, (scene, changes) in (ALL_FEATURES | SCHEDULES | SPECIALISED).items():
    film = Session("cpu", cache_folder=sys.argv[1]).render(scene, SETTINGS.replace(**changes))
    if film.statistics["auto"]["kernel_tier"]["value"] == "GENERAL":
        general.append(feature)
print(json.dumps([compiled, general]))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with the kernels that any scene can begin with, and no others that tests compiled."""
    folder = tmp_path_factory.mktemp("kernels")
    put_general_kernels(folder)
    return folder


@pytest.mark.skipif(DEVICE != "cpu", reason="on the CPU alone")
def test_no_scene_compiles_before_its_first_picture(folder):
    """Compilations are counted: how long they take depends on the machine."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    kept = {"RAYBATCH_KERNEL_TIER": "AUTO", "RAYBATCH_KERNEL_CACHE": str(folder), "WARP_CACHE_PATH": str(folder)}
    command = [sys.executable, "-c", PROCESS, str(folder)]
    done = subprocess.run(command, env=environment | kept, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    compiled, general = json.loads(done.stdout)
    assert (set(compiled), general) == (NOT_AHEAD, [*ALL_FEATURES, *SCHEDULES]), compiled
