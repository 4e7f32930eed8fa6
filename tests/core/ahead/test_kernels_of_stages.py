"""Which general kernels shade a scene: those that leave out what few scenes have, or the large one."""

from dataclasses import replace

import pytest
import warp as wp

from raybatch_addon.core.ahead.request import GeneralRequest
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.passes import GUIDE_PASSES
from raybatch_addon.core.scene.program import ProgramFeatures
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.kernels import StageKernels, is_common, is_wide
from raybatch_addon.core.wavefront.stages.work import ShadingStage
from raybatch_addon.core.wavefront.tier import general_features, general_kernels
from tests.support import scenes
from tests.support.feature_scenes import EACH_FEATURE, EACH_WIDE_FEATURE, FEATURES, SETTINGS, WIDE_FEATURES
from tests.support.under_test import DEVICE


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
