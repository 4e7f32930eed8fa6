"""Where light is aimed at."""

import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.shading.lights.table import LightTable
from raybatch_addon.core.wavefront.stages.limits import PathLimits
from raybatch_addon.core.wavefront.stages.surface.aim import is_aimed
from raybatch_addon.core.wavefront.stages.surface.vertex import Vertex
from tests.support.under_test import DEVICE


@wp.kernel(**KERNEL_OPTIONS)
def aims(lights: LightTable, limits: PathLimits, x: int, last: int, answer: wp.array(dtype=int)):
    v = Vertex()
    v.pixel.x = x
    v.last = last != 0
    if is_aimed(lights, limits, v):
        answer[0] = 1


@pytest.mark.parametrize(("emitters", "x", "last", "aimed"), [(1, 7, 0, 1), (0, 7, 0, 0), (1, 8, 0, 0), (1, 7, 1, 0)])
def test_light_is_aimed_at_where_there_are_slots_for_its_rays(emitters, x, last, aimed):
    """The kernels of all scenes aim too; without emitters, paths have one ray slot alone."""
    lights, limits = LightTable(), PathLimits()
    lights.emitter_count, limits.nee_end = emitters, 8
    answer = wp.zeros(1, dtype=int, device=DEVICE)
    wp.launch(aims, 1, [lights, limits, x, last, answer], device=DEVICE)
    assert answer.numpy()[0] == aimed
