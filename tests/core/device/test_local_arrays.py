"""Local arrays of kernels are set to zero once or not at all, and what is not set is not read."""

import hashlib
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.ahead.request import GeneralRequest
from raybatch_addon.core.device.codegen import local_arrays
from raybatch_addon.core.device.codegen.local_arrays import Unset, set_once
from raybatch_addon.core.device.devices import find_device, start_warp
from raybatch_addon.core.device.kernel import MODULE_OPTIONS, is_general
from raybatch_addon.core.session import Session
from raybatch_addon.core.shading.bsdf.materials import address_of
from tests.core.device.small_kernels import ROOT
from tests.support.feature_scenes import ALL_FEATURES
from tests.support.feature_scenes import SETTINGS as FEATURE_SETTINGS
from tests.support.running.general_kernels import general_source
from tests.support.running.shares import thorough_but
from tests.support.under_test import DEVICE

ON_CPU = pytest.mark.skipif(DEVICE != "cpu", reason="on the CPU alone")
COUNT = 7


@wp.func
def summed(values: wp.array(dtype=float)) -> float:
    total = float(0.0)
    for k in range(COUNT):
        total += values[k]
    return total


@wp.func
def of_a_function(i: int) -> float:
    total = float(0.0)
    for turn in range(2):
        held = wp.zeros(COUNT, dtype=float)  # anew in each turn
        total += summed(held)
        held[turn] = float(i)
        total += summed(held)
    return total


def kernel_of(options):
    def compute(out: wp.array2d(dtype=float)):
        i = wp.tid()
        held = wp.zeros(COUNT, dtype=float)
        unset = wp.zeros(COUNT, dtype=Unset)
        floats = wp.array(ptr=address_of(unset), shape=(COUNT,), dtype=float)
        for k in range(COUNT):
            floats[k] = float(k * i)
        held[i] = 1.0
        out[i, 0] = summed(held)
        out[i, 1] = summed(floats)
        out[i, 2] = of_a_function(i)

    return wp.kernel(compute, module="unique", module_options=options, enable_backward=False)


def source_of(kernel, device):
    module = kernel.module
    module.get_module_hash(1)
    return module._run_codegen(module.resolved_options[1] | {"output_arch": None}, device == "cpu")[0]


def test_arrays_hold_zeros_or_what_was_written(device):
    start_warp()
    out = wp.zeros((4, 3), dtype=float, device=device)
    wp.launch(kernel_of(MODULE_OPTIONS), dim=4, inputs=[out], device=device)
    i = np.arange(4)
    np.testing.assert_array_equal(out.numpy(), np.stack([np.ones(4), 21.0 * i, 2.0 * i], axis=1))


def test_no_array_of_the_core_is_copied():
    start_warp()
    source = source_of(kernel_of(MODULE_OPTIONS), "cpu")
    assert "fixedarray_t" not in source
    declared = re.findall(r"wp::array_t<wp::float32> (var_\d+)\(reinterpret_cast", source)
    zeroed = re.findall(r"(var_\d+)\.data\[k\] = wp::float32\(\);", source)
    assert zeroed == declared != [], "each once"
    assert "data[k] = Unset" not in source


@ON_CPU
def test_no_array_of_general_kernels_is_copied():
    start_warp()
    named = GeneralRequest().kernels(find_device("cpu"))  # one for each stage, most of them the same
    kernels = [each for each in dict.fromkeys(named) if is_general(each.module)]
    sources = [general_source(each) for each in kernels]
    assert sum(source.count("_storage[") for source in sources) > 20
    assert not [each.key for each, source in zip(kernels, sources, strict=True) if "fixedarray_t" in source]


def test_modules_of_others_are_left_alone():
    start_warp()
    assert "fixedarray_t" in source_of(kernel_of(MODULE_OPTIONS | {"cpu_compiler_flags": ""}), "cpu")


DECLARED = "    wp::fixedarray_t<4, wp::float32> var_1;\n"
ASSIGNED = "    var_1 = wp::fixedarray_t<4, wp::float32>(var_2);\n"


def test_what_warp_would_write_another_way_stays():
    assert set_once(DECLARED + ASSIGNED) != DECLARED + ASSIGNED
    for source in (
        "    wp::fixedarray_t<4, wp::float32> var_1;\n    var_1 = wp::fixedarray_t<4, wp::float32>(var_2, var_3);\n",
        "    wp::fixedarray_t<4, wp::float32> var_1;\n    foo(var_1);\n",
        DECLARED + 2 * ASSIGNED,
        DECLARED + ASSIGNED + "    var_4 = var_1;\n",
        DECLARED + ASSIGNED + "    wp::assign(var_4, var_1);\n",
        DECLARED + ASSIGNED + "    var_5 = wp::where(var_6, var_4, var_1);\n",
    ):
        assert set_once(source) == source


# Renders the features named on the command line with arrays that hold `sys.argv[1]`
FILLED = """
import json, sys
from raybatch_addon.core.device.codegen import local_arrays
local_arrays.fill_unset = sys.argv[1]
from tests.core.device.test_local_arrays import digests
print(json.dumps(digests(sys.argv[3:], sys.argv[2])))
"""
# A number that no comparison holds for, and one that is larger than all that kernels deal with
SPECIALISED = ("subsurface", "a volume with a program", "all passes of a program")
FILLS = ['__builtin_nanf("")', "3e37f"]


def digests(features, tier):
    """Of all passes of films by kernels of `tier`."""
    found = {}
    for feature in features:
        scene, changes = ALL_FEATURES[feature]
        film = Session("cpu").render(scene, FEATURE_SETTINGS.replace(kernel_tier=tier, **changes))
        digest = hashlib.sha256()
        for name in sorted(film.passes):
            digest.update(name.encode() + np.ascontiguousarray(film.passes[name]).tobytes())
        found[feature] = digest.hexdigest()
    return found


def filled(fill, tier, features, folder):
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "RAYBATCH_KERNEL_CACHE": str(folder),
        "WARP_CACHE_PATH": str(folder),
    }
    environment.pop("RAYBATCH_KERNEL_TIER", None)
    done = subprocess.run(
        [sys.executable, "-c", FILLED, fill, tier, *features], env=environment, capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@ON_CPU
@pytest.mark.parametrize("fill", thorough_but((), dict.fromkeys(FILLS)))
def test_nothing_is_read_before_it_is_written(fill, tmp_path):
    features = [*ALL_FEATURES]
    assert filled(fill, "GENERAL", features, tmp_path) == digests(features, "GENERAL")


@ON_CPU
@pytest.mark.parametrize("feature", thorough_but((), SPECIALISED))
def test_nothing_is_read_before_it_is_written_by_specialised_kernels(feature, tmp_path):
    assert filled(FILLS[0], "SPECIALISED", [feature], tmp_path) == digests([feature], "SPECIALISED")


def test_filled_arrays_are_filled(monkeypatch):
    start_warp()
    monkeypatch.setattr(local_arrays, "fill_unset", "3e37f")
    source = source_of(kernel_of(MODULE_OPTIONS), "cpu")
    assert len(re.findall(r"\.data\[k\] = Unset_\w+\(3e37f\);", source)) == 1
