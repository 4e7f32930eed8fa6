"""What is known of tracing before a scene is built."""

import itertools

import pytest

from raybatch_addon.core.bvh.build.scene_tree import layout_for
from raybatch_addon.core.device.devices import find_device
from raybatch_addon.core.scene.features import SceneFeatures
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.kernels import tracing_kernels
from raybatch_addon.core.wavefront.order.ray_sort import sort_kernel
from raybatch_addon.core.wavefront.plan.plan import Method, TracingPlan
from raybatch_addon.core.wavefront.plan.tracing import Tracing
from tests.support.under_test import DEVICE

SORTS = {
    **{(method, mode): mode for method in (Method.UNBATCHED, Method.REFERENCE) for mode in ("AUTO", "ON", "OFF")},
    (Method.BATCHED, "AUTO"): "OFF",
    (Method.BATCHED, "ON"): "ON",
    (Method.BATCHED, "OFF"): "OFF",
    **{(Method.PAGED, mode): "OFF" for mode in ("AUTO", "ON", "OFF")},
}


@pytest.mark.parametrize(("method", "mode"), list(itertools.product(Method, ("AUTO", "ON", "OFF"))))
def test_rays_are_sorted_where_their_order_is_kept(method, mode):
    """And what sorts them is compiled nowhere else."""
    device = find_device(DEVICE)
    features, settings = SceneFeatures(surfaces=True), RenderSettings(ray_sort=mode)
    tracing = Tracing.of(TracingPlan(method), layout_for(device), features)
    assert tracing.sort_mode(settings) == SORTS[method, mode]
    compiled = sort_kernel(device) in tracing_kernels(features, settings, tracing, device)
    assert compiled == (SORTS[method, mode] != "OFF")
