"""Volumes of programs whose bounds are hard to find: without end, far too high, or different for each kind of ray."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Volume
from tests.renders.volumes.test_volumes import assert_mean, in_box
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")


def absorbing(density) -> Volume:
    """A volume that absorbs as much as `density(builder)` says."""
    builder = ProgramBuilder()
    builder.closure("volume_absorption", builder.value("splat", density(builder)))
    return Volume(program=builder.finish())


def test_a_volume_that_only_some_rays_see(session):
    """A cube of 2 m that is dense for camera rays alone."""
    volume = absorbing(lambda builder: builder.value("light_path")[0])
    assert_mean(session, in_box(volume), np.exp(-2.0))


def test_fog_of_the_world_that_thins_out_has_an_end(session):
    """A ray straight up through fog that thins out with height comes back with what passes."""

    def density(builder):
        height = builder.value("separate_xyz", builder.value("volume_position", 0))[2]
        fallen = builder.value("math", 2, False, height, -0.5, 0.0)
        return builder.value("math", 2, False, builder.value("math", 10, False, fallen, 0.0, 0.0), 0.1, 0.0)

    view = scenes.camera(eye=(0, 0, 0), target=(0, 0, 10), up=(0, 1, 0), half_width=0.01)
    made = in_box(Volume(), view)
    made = dataclasses.replace(made, world=dataclasses.replace(made.world, volume=absorbing(density)))
    assert_mean(session, made, np.exp(-0.1 / 0.5))
