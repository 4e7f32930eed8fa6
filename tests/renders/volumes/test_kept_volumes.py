"""Grids and bounds of volumes are made once for all renders that a session makes of them."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Grid, Volume
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.volumes import upload
from tests.renders.volumes.test_volumes import in_box
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")

_TO_INDEX = np.column_stack([np.eye(3) * 2.0, np.full(3, 1.5)])
_VALUES = np.random.default_rng(5).random((4, 4, 4)).astype(np.float32)


def smoky(values=_VALUES, strength=1.0):
    """A cube that absorbs what its grid says, times `strength`; as exporters make it, of new arrays."""
    builder = ProgramBuilder()
    _, density, _ = builder.value("volume_attribute", 0, 0.0)
    weight = builder.value("math", 2, False, density, strength, 0.0)
    builder.closure("volume_absorption", builder.value("splat", weight))
    made = in_box(Volume(program=builder.finish()), scenes.camera(eye=(0, -4, 0), half_width=0.3))
    box = dataclasses.replace(made.meshes[0], grids=(Grid("density", values.copy(), _TO_INDEX.copy()),))
    return dataclasses.replace(made, meshes=(box, *made.meshes[1:]), attributes=(("GRID", "density"),))


@pytest.fixture
def made(monkeypatch):
    """What was made, by name, in order."""
    calls = []
    find, load = upload.find_bounds, wp.Volume.allocate_by_tiles

    def counted_find(*args):
        calls.append("bounds")
        return find(*args)

    def counted_load(*args, **kwargs):
        calls.append("grid")
        return load(*args, **kwargs)

    monkeypatch.setattr(upload, "find_bounds", counted_find)
    monkeypatch.setattr(wp.Volume, "allocate_by_tiles", counted_load)
    return calls


def film(scene, session):
    return session.render(scene, RenderSettings(device=DEVICE, sample_count=2)).passes["Combined"].tobytes()


def test_the_same_volumes_are_made_once(made):
    session = Session(DEVICE)
    first = film(smoky(), session)
    assert made == ["grid", "bounds"]
    assert film(smoky(), session) == first and made == ["grid", "bounds"]
    # where the camera is does not matter to a cube
    moved = dataclasses.replace(smoky(), camera=scenes.camera(eye=(1, -4, 0), half_width=0.3))
    assert film(moved, session) != first and made == ["grid", "bounds"]


def test_uv_maps_that_no_volume_reads_may_change(made):
    session = Session(DEVICE)
    scene = smoky()

    def mapped(value):
        uvs = np.full((len(scene.meshes[0].triangles), 3, 2), value, np.float32)
        return dataclasses.replace(scene, meshes=(dataclasses.replace(scene.meshes[0], corner_uvs=uvs),))

    first = film(mapped(0.25), session)
    made.clear()
    assert film(mapped(0.5), session) == first and made == []


@pytest.mark.parametrize(
    "change, again", [("values", ["grid", "bounds"]), ("program", ["bounds"]), ("place", ["bounds"])]
)
def test_what_changes_is_made_again(made, change, again):
    session = Session(DEVICE)
    film(smoky(), session)
    made.clear()
    other = (
        smoky(_VALUES * np.float32(8.0)) if change == "values" else smoky(strength=8.0 if change == "program" else 1)
    )
    if change == "place":
        transform = other.instances.transform.copy()
        transform[0, 0, 0] = 2.0
        other = dataclasses.replace(other, instances=dataclasses.replace(other.instances, transform=transform))
    shown = film(other, session)
    assert made == again
    assert shown == film(other, Session(DEVICE)), "as a session shows it that has nothing to keep"


def test_a_session_forgets_the_volumes_of_scenes_before(made):
    session = Session(DEVICE)
    film(smoky(), session)
    film(in_box(Volume()), session)
    assert session._at[0].cache.volumes.device_bytes == 0
