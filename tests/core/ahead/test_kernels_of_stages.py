"""Which general kernels shade a scene: those that leave out what few scenes have, or the large one."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import warp as wp

from raybatch_addon.core.ahead.request import GeneralRequest
from raybatch_addon.core.programs.requests import prepared_scene
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.passes import GUIDE_PASSES
from raybatch_addon.core.scene.program import ProgramFeatures
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront import kernels
from raybatch_addon.core.wavefront.kernels import StageKernels, is_common, is_wide
from raybatch_addon.core.wavefront.stages.work import ShadingStage
from raybatch_addon.core.wavefront.tier import general_features, general_kernels, why_not_general
from tests.support import scenes
from tests.support.feature_scenes import (
    ALL_FEATURES,
    EACH_FEATURE,
    EACH_WIDE_FEATURE,
    FEATURES,
    SETTINGS,
    WIDE_FEATURES,
)
from tests.support.under_test import DEVICE


def _features_of(name):
    scene, changes = ALL_FEATURES[name]
    settings = SETTINGS.replace(**changes)
    return derive_features(prepared_scene(scene, settings), settings)


def test_kernels_for_each_stage_are_chosen_where_they_have_all_that_a_scene_has():
    for features, wide in ((FEATURES | EACH_FEATURE, False), (WIDE_FEATURES | EACH_WIDE_FEATURE, True)):
        for name, (scene, changes) in features.items():
            found = derive_features(scene, SETTINGS.replace(**changes))
            assert is_wide(found) == wide or (found.volumes and wide), name


@pytest.mark.skipif(DEVICE != "cpu", reason="on the CPU alone")
def test_surfaces_of_common_scenes_are_shaded_by_less_code():
    """The kernel is compiled ahead, without what few scenes have; rare features and ops ask for the large one."""
    device, programs = wp.get_device(DEVICE), ProgramFeatures(("diffuse", "noise_3d"), 16, 4)
    features = replace(derive_features(scenes.mixed(Frame(24, 20)), RenderSettings(sample_count=4)), programs=programs)
    assert is_common(features)
    kernel = StageKernels.choose(features, device, general_features(device)).shading[ShadingStage.SURFACE]
    assert kernel in GeneralRequest().kernels(device) and kernel not in general_kernels(device)

    def kernel_with(**changes):
        return StageKernels.choose(replace(features, **changes), device, general_features(device)).shading[
            ShadingStage.SURFACE
        ]

    for passes in (("Depth", "Mist"), ("Diffuse Direct", "Glossy Color"), GUIDE_PASSES, ("CryptoObject00",)):
        assert kernel_with(passes=("Combined", *passes)) is kernel, passes
    assert kernel_with(passes=("Combined", *GUIDE_PASSES), programs=ProgramFeatures()) is kernel
    asking = replace(programs, ops=("bevel", "diffuse"))
    for changes in (dict(passes=("Combined", "Combined_key")), dict(curves=True), dict(programs=asking)):
        assert kernel_with(**changes) is general_kernels(device)[0], changes


@pytest.mark.parametrize("is_cuda", [False, True])
def test_all_general_kernels_that_shade_are_compiled_ahead(is_cuda):
    device = SimpleNamespace(is_cuda=is_cuda, is_cpu=not is_cuda, alias="cuda:0" if is_cuda else "cpu")
    general, ahead = general_features(device), set()
    for name in ALL_FEATURES:
        features = _features_of(name)
        if why_not_general(features, device) or (is_cuda and features.occlusion_pass):  # specialised on the scene
            continue
        ahead = ahead or set(GeneralRequest().kernels(device))
        assert set(StageKernels.choose(features, device, general).that_shade()) <= ahead, name


def test_volumes_that_are_no_programs_have_kernels_of_their_own():
    """Not beside what few scenes have, or lamps that are programs."""
    device, lamp = wp.get_device(DEVICE), ProgramFeatures(("emission",), 16, 1)
    features = replace(_features_of("volume"), lamp_program=ProgramFeatures())
    large = StageKernels.choose(replace(features, volume_program=lamp), device, general_features(device)).volumes
    own = StageKernels.choose(features, device, general_features(device)).volumes
    assert large.scatter is large.transmit and len({own.scatter, own.transmit, large.scatter}) == 3
    for changes in (dict(lamp_program=lamp), dict(curves=True)):
        found = StageKernels.choose(replace(features, **changes), device, general_features(device)).volumes
        assert found.scatter is large.scatter, changes


def test_a_gpu_knows_of_lamps_that_are_programs_where_surfaces_are_none(monkeypatch):
    """Such a lamp may cast no shadow."""
    made, real = [], kernels.make_shade_surface

    def make_shade_surface(features, aims):
        made.append(features)
        return real(features, aims)

    monkeypatch.setattr(kernels, "make_shade_surface", make_shade_surface)
    features = replace(
        derive_features(scenes.mixed(Frame(24, 20)), SETTINGS), lamp_program=ProgramFeatures(("emission",), 16, 1)
    )
    general = general_features(SimpleNamespace(is_cuda=True))
    kernels._chosen.__wrapped__(features, general, True, False)
    assert made[0].lamp_programs and not made[0].programs  # the large kernel comes after it
