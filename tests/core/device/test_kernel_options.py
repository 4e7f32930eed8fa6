"""Every kernel of the core is compiled without contraction, fast math or adjoints."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import (
    MODULE_OPTIONS,
    OPTIMISATION,
    OUT_OF_LINE_OPTIONS,
    SPECIALISED_CODE,
    is_general,
    optimisation_level,
    specialised_out_of_line,
)
from raybatch_addon.core.errors import SettingsError
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.estimates.kernels import estimate_kernel
from raybatch_addon.core.wavefront.estimates.work import Estimate
from raybatch_addon.core.wavefront.kernels import StageKernels
from raybatch_addon.core.wavefront.stages.work import ShadingStage
from tests.support import scenes
from tests.support.command_line import run_python
from tests.support.feature_scenes import ALL_FEATURES, SETTINGS
from tests.support.under_test import DEVICE

ESTIMATES = (Estimate.TRIANGLES, Estimate.WORLD, Estimate.LAMPS)


def test_every_loaded_module_has_the_options(session):
    session.render(scenes.mixed(), RenderSettings(sample_count=1))
    seen = 0
    for name, module in wp._src.context.user_modules.items():
        kernels = [k for k in module.kernels.values() if k.func.__module__.startswith("raybatch_addon.core")]
        for kernel in kernels:
            seen += 1
            options = {key: module.options[key] for key in MODULE_OPTIONS}
            assert options in (
                [OUT_OF_LINE_OPTIONS] if is_general(module) else [MODULE_OPTIONS, OUT_OF_LINE_OPTIONS]
            ), name
            assert kernel.options.get("enable_backward") is False, name
    assert seen >= 10


def test_films_do_not_depend_on_the_code_of_specialised_kernels(session, monkeypatch):
    scene = scenes.scene([(scenes.sphere(), scenes.IDENTITY, scenes.diffuse())], lights=[scenes.area_light(3.0)])
    settings = RenderSettings(sample_count=2, bounce_max=1, kernel_tier="SPECIALISED")
    features = derive_features(scene, settings)
    films, options = [], []
    for code in ("INLINED", "OUT_OF_LINE"):
        monkeypatch.setenv(SPECIALISED_CODE, code)
        films.append(session.render(scene, settings).passes["Combined"])
        surface = StageKernels.choose(features, wp.get_device(DEVICE)).shading[ShadingStage.SURFACE]
        options.append(surface.module.options["cpu_compiler_flags"])
    assert options == [MODULE_OPTIONS["cpu_compiler_flags"], OUT_OF_LINE_OPTIONS["cpu_compiler_flags"]]
    np.testing.assert_array_equal(*films)
    assert films[0].std() > 0


@pytest.mark.parametrize("code", ["INLINED", "OUT_OF_LINE"])
def test_volumes_and_estimates_have_the_code_that_is_asked_for(monkeypatch, code):
    """Kernels are declared, not compiled."""
    monkeypatch.setenv(SPECIALISED_CODE, code)
    scene, changes = ALL_FEATURES["a volume with a program"]
    features = derive_features(scene, SETTINGS.replace(**changes))
    assert features.volumes and features.volume_program
    volumes = StageKernels.choose(features, wp.get_device(DEVICE)).volumes
    expected = (OUT_OF_LINE_OPTIONS if code == "OUT_OF_LINE" else MODULE_OPTIONS)["cpu_compiler_flags"]
    for kernel in (volumes.scatter, volumes.transmit, *(estimate_kernel(features, of) for of in ESTIMATES)):
        assert kernel.module.options["cpu_compiler_flags"] == expected, kernel.key


@pytest.mark.parametrize("unset", [None, ""])
def test_users_have_specialised_kernels_inlined(monkeypatch, unset):
    monkeypatch.delenv(SPECIALISED_CODE, raising=False)
    if unset is not None:
        monkeypatch.setenv(SPECIALISED_CODE, unset)
    assert not specialised_out_of_line()


def test_a_code_that_does_not_exist_is_refused(monkeypatch):
    monkeypatch.setenv(SPECIALISED_CODE, "SMALL")
    with pytest.raises(SettingsError, match="INLINED, OUT_OF_LINE"):
        specialised_out_of_line()


# Prints the level that a process compiles with, and the name of a kernel's module, which is that of its file
LEVEL = """
import warp as wp
from raybatch_addon.core.device.devices import start_warp
from raybatch_addon.core.film.tile import add_spill_kernel as kernel
start_warp()
print(wp.config.optimization_level, kernel.module.get_module_identifier())
"""


def test_kernels_of_another_optimisation_have_other_names(monkeypatch):
    monkeypatch.delenv(OPTIMISATION, raising=False)
    assert optimisation_level() is None
    said = {}
    for level in ("", "1", "3"):
        monkeypatch.setenv(OPTIMISATION, level)
        said[level] = run_python(LEVEL).stdout.split()
    assert [level for level, _ in said.values()] == ["None", "1", "3"]
    assert len({name for _, name in said.values()}) == 3


@pytest.mark.parametrize("level", ["4", "fast"])
def test_a_level_that_does_not_exist_is_refused(monkeypatch, level):
    monkeypatch.setenv(OPTIMISATION, level)
    message = f"{OPTIMISATION} is {level!r}; set it to one of 0, 1, 2, 3, or not at all"
    with pytest.raises(SettingsError, match=message):
        optimisation_level()
    assert f"SettingsError: {message}" in run_python(LEVEL).stderr
