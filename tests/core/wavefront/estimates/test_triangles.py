"""The mean emission of triangles whose material is a program."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.description import ClosureKind
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.estimates import launch as estimates
from raybatch_addon.core.wavefront.scene import device_scene
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")


def glowing():
    """A ball that glows with its own coordinates, so that each of its triangles has its own brightness."""
    builder = ProgramBuilder()
    builder.closure("emission", builder.value("object_coordinates", 0))
    glow = scenes.material(kinds=(ClosureKind.EMISSION,))
    return scenes.scene([(scenes.sphere(), scenes.IDENTITY, dataclasses.replace(glow, program=builder.finish()))])


def test_parts_on_several_threads_are_those_of_one(session, monkeypatch):
    real, launch, found, parts = device_scene.emission_of_triangles, wp.launch, [], []

    def counted(kernel, count, *inputs, **more):
        parts.append(count)
        launch(kernel, count, *inputs, **more)

    def watched(data, features, device, instance, primitive):
        for threads in (1, 3, 8):
            monkeypatch.setattr(estimates, "worker_count", lambda device, wanted, threads=threads: threads)
            monkeypatch.setattr(wp, "launch", counted)
            found.append(real(data, features, device, instance, primitive))
            monkeypatch.setattr(wp, "launch", launch)
            assert len(parts) == threads and sum(parts) == len(instance)
            parts.clear()
        few = real(data, features, device, instance[:2], primitive[:2])  # which are seen from more directions
        np.testing.assert_allclose(few, found[0][:2], rtol=1e-4)
        return found[0]

    monkeypatch.setattr(device_scene, "emission_of_triangles", watched)
    session.render(glowing(), RenderSettings(sample_count=1))
    one, *others = found
    assert len(np.unique(one, axis=0)) > len(one) / 4
    assert all(np.array_equal(one, other) for other in others)


def sheet(x_of, width: float, strength: float):
    """A square plane that emits `strength` where x is less than `width`: of `x_of(builder)`."""
    builder = ProgramBuilder()
    x = builder.value("separate_xyz", x_of(builder))[0]
    x = builder.value("math", int(MathOperation.ABSOLUTE), 0, x, 0.0, 0.0)
    lit = builder.value("math", int(MathOperation.LESS_THAN), 0, x, width, 0.0)
    glow = builder.value("math", int(MathOperation.MULTIPLY), 0, lit, strength, 0.0)
    builder.closure("emission", builder.value("combine_xyz", glow, glow, glow))
    shines = scenes.material(kinds=(ClosureKind.EMISSION,))
    return scenes.scene([(scenes.plane(), scenes.IDENTITY, dataclasses.replace(shines, program=builder.finish()))])


def counted(session, monkeypatch, scene):
    """What the triangles of `scene` count for."""
    real, found = device_scene.emission_of_triangles, []
    watched = lambda *of: found.append(real(*of)) or found[-1]  # noqa: E731
    monkeypatch.setattr(device_scene, "emission_of_triangles", watched)
    session.render(scene, RenderSettings(sample_count=1))
    return found[0]


def test_a_beam_counts_as_its_mean_times_the_directions_it_shines_into(session, monkeypatch):
    """A sheet of light: directions by the cosine lie evenly in a disk, of which a strip is lit."""
    part = 4 / np.pi * 0.05
    found = counted(session, monkeypatch, sheet(lambda builder: builder.value("normals")[2], 0.05, 1000.0))
    np.testing.assert_allclose(found, 1000 * part**2, rtol=0.4)


@pytest.mark.parametrize(("runs", "strength"), [(2**17, 10.0), (0, 20.0)])
def test_what_shines_into_all_directions_counts_as_its_mean(session, monkeypatch, runs, strength):
    """Of a stripe, whether all points are looked at from each direction or one."""
    monkeypatch.setattr(estimates, "_TRIANGLE_RUNS", runs)
    found = counted(session, monkeypatch, sheet(lambda builder: builder.value("position", 0), 0.4, strength))
    np.testing.assert_allclose(found.mean(), 0.4 * strength, rtol=0.4)
