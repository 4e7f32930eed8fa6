"""What few scenes have, in the general tier: on a CPU all of it, on a GPU what is no part of the large kernels."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.ahead.request import GeneralRequest
from raybatch_addon.core.bvh.build.refit import join_boxes_kernel, write_boxes_kernel
from raybatch_addon.core.displacement.displaced import DisplacedMeshes
from raybatch_addon.core.programs.op import op_named, op_numbers
from raybatch_addon.core.programs.requests import prepared_scene
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.shading.images.textures import ImageTable
from raybatch_addon.core.wavefront import tier
from raybatch_addon.core.wavefront.estimates.displacement import mover
from raybatch_addon.core.wavefront.estimates.kernels import estimate_kernel
from raybatch_addon.core.wavefront.estimates.work import Estimate
from raybatch_addon.core.wavefront.tier import VARIABLE, general_features, why_not_general
from tests.core.ahead.outside_general import SPECIALISED, SPECIALISED_ON_A_GPU
from tests.support import scenes
from tests.support.feature_scenes import ALL_FEATURES, FEATURES, SETTINGS
from tests.support.under_test import DEVICE

PAGE = Path(__file__).resolve().parents[3] / "docs/architecture.md"


CPU, GPU = SimpleNamespace(is_cuda=False), SimpleNamespace(is_cuda=True)


def features_of(scene, changes):
    settings = SETTINGS.replace(**changes)
    return derive_features(prepared_scene(scene, settings), settings)


@pytest.mark.parametrize("feature", SPECIALISED_ON_A_GPU.values())
def test_general_kernels_of_a_gpu_lack_what_few_scenes_have(feature):
    """And say so: their compiler takes minutes."""
    features = features_of(*ALL_FEATURES[feature])
    assert why_not_general(features, GPU).startswith("general kernels have no code for ")
    assert why_not_general(features, CPU) == ""
    assert why_not_general(derive_features(scenes.mixed(), SETTINGS), GPU) == ""


@pytest.mark.parametrize("feature", SPECIALISED)
def test_general_kernels_lack_what_hardly_a_scene_has(feature):
    for device in (CPU, GPU):
        assert why_not_general(features_of(*SPECIALISED[feature]), device).startswith("general kernels have ")


def test_the_page_lists_what_is_not_in_general_kernels():
    """All of it, and nothing else."""
    page = " ".join(PAGE.read_text(encoding="utf-8").split())
    (of_all,) = re.findall(r"Not in them: (.*?)\.", page)
    (of_a_gpu,) = re.findall(r"Those for a GPU, whose compiler [^:]*also lack: (.*?)\.", page)
    assert set(of_all.split(", ")) == set(SPECIALISED)
    assert set(of_a_gpu.split(", ")) == set(SPECIALISED_ON_A_GPU)
    there = [features_of(*each) for each in SPECIALISED.values()]
    assert not {
        name for name in op_numbers() if not op_named(name).general and not name.startswith(("image_", "tiled_"))
    } - {name for each in there for name in (*each.programs.ops, *each.volume_program.ops)}
    assert not tier._LEFT_OUT - {kind for each in there for kind in each.closures}
    there += [features_of(*ALL_FEATURES[name]) for name in SPECIALISED_ON_A_GPU.values()]
    assert not tier._KINDS_LEFT_OUT - {kind for each in there for kind in each.closures}
    ops = {name for each in there for name in each.programs.ops}
    assert tier._OPS_LEFT_OUT - ops == {"vertex_offset"}, "displacement has a kernel of its own"
    lacking = [name for name in tier._LINKS if not getattr(general_features(GPU), name)]
    assert {tier._LINKS[name] for name in lacking} == {
        tier._LINKS[name] for each in there for name in lacking if getattr(each, name)
    }


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
    for asked in ("SPECIALISED", "GENERAL", "AUTO"):
        launched.clear()
        displaced = DisplacedMeshes().displaced(scene, ImageTable, device, mover(asked))
        kernel = estimate_kernel(general_features(device), Estimate.DISPLACEMENT)
        assert (kernel in launched) == (asked != "SPECIALISED"), asked
        moved.append([mesh.positions for mesh in displaced.meshes])
    assert not np.array_equal(moved[0][-1], scene.meshes[-1].positions)
    for positions in moved[1:]:
        assert all(np.array_equal(*each) for each in zip(positions, moved[0], strict=True))


def test_trees_of_a_next_frame_are_fitted_by_kernels_that_are_there():
    kernels = GeneralRequest().kernels(wp.get_device("cpu"))
    assert {join_boxes_kernel, write_boxes_kernel} <= set(kernels)
