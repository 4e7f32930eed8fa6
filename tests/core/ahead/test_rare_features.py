"""What few scenes have, in the general tier: on a CPU all of it, on a GPU what is no part of the large kernels."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.ahead.request import GeneralRequest
from raybatch_addon.core.bvh.build.refit import join_boxes_kernel, write_boxes_kernel
from raybatch_addon.core.displacement.displaced import DisplacedMeshes
from raybatch_addon.core.programs.requests import prepared_scene
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.shading.images.textures import ImageTable
from raybatch_addon.core.wavefront.estimates.displacement import mover
from raybatch_addon.core.wavefront.estimates.kernels import estimate_kernel
from raybatch_addon.core.wavefront.estimates.work import Estimate
from raybatch_addon.core.wavefront.tier import VARIABLE, general_features, why_not_general
from tests.support import scenes
from tests.support.feature_scenes import ALL_FEATURES, FEATURES, SETTINGS
from tests.support.under_test import DEVICE


@pytest.mark.parametrize(
    "feature",
    ["rays for programs", "linked light", "linked shadows", "groups", "portal of the world", "sent on elsewhere"],
)
def test_general_kernels_of_a_gpu_lack_what_few_scenes_have(feature):
    """And say so: their compiler takes minutes."""
    scene, changes = ALL_FEATURES[feature]
    settings = SETTINGS.replace(**changes)
    features = derive_features(prepared_scene(scene, settings), settings)
    assert why_not_general(features, SimpleNamespace(is_cuda=True)).startswith("general kernels have no code for ")
    assert why_not_general(derive_features(scenes.mixed(), settings), SimpleNamespace(is_cuda=True)) == ""


@pytest.mark.skipif(DEVICE != "cpu", reason="on the CPU alone")
def test_displacement_is_by_general_kernels_where_these_are_ready(monkeypatch):
    """General kernels move vertices to where specialised ones do, and nothing is compiled for one scene."""
    scene, _ = FEATURES["displacement"]
    launched = []
    launch = wp.launch

    def noted(kernel, *more, **named):
        launched.append(kernel)
        return launch(kernel, *more, **named)

    monkeypatch.delenv(VARIABLE)
    monkeypatch.setattr(wp, "launch", noted)
    device, moved = wp.get_device("cpu"), []
    for tier in ("SPECIALISED", "GENERAL", "AUTO"):
        launched.clear()
        displaced = DisplacedMeshes().displaced(scene, ImageTable, device, mover(tier))
        kernel = estimate_kernel(general_features(device), Estimate.DISPLACEMENT)
        assert (kernel in launched) == (tier != "SPECIALISED"), tier
        moved.append([mesh.positions for mesh in displaced.meshes])
    assert not np.array_equal(moved[0][-1], scene.meshes[-1].positions)
    for positions in moved[1:]:
        assert all(np.array_equal(*each) for each in zip(positions, moved[0], strict=True))


def test_trees_of_a_next_frame_are_fitted_by_kernels_that_are_there():
    kernels = GeneralRequest().kernels(wp.get_device("cpu"))
    assert {join_boxes_kernel, write_boxes_kernel} <= set(kernels)
