"""The mean emission of triangles whose material is a program."""

import dataclasses

import numpy as np
import warp as wp

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import ClosureKind
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.estimates import launch as estimates
from raybatch_addon.core.wavefront.scene import device_scene
from tests.support import scenes


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
        few = real(data, features, device, instance[:2], primitive[:2])
        assert np.array_equal(few, found[0][:2])
        return found[0]

    monkeypatch.setattr(device_scene, "emission_of_triangles", watched)
    session.render(glowing(), RenderSettings(sample_count=1))
    one, *others = found
    assert len(np.unique(one, axis=0)) > len(one) / 4
    assert all(np.array_equal(one, other) for other in others)
