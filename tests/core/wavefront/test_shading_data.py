"""The data of a scene that kernels get."""

import ctypes

from raybatch_addon.core.wavefront.scene.shading_data import SceneData

# NVIDIA's compiler copies a larger parameter to each thread's local memory, 8 KB in each launch of a stage: that took
# four times as long as the shading itself
PARAMETER_MOST = 8192


def test_a_scene_is_small_enough_to_stay_in_constant_memory():
    assert ctypes.sizeof(SceneData.ctype) <= PARAMETER_MOST
