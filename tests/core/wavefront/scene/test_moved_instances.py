"""Frames in which instances moved: what is looked at, and that every film is that of a new session."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.bvh.build import mesh_tree
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.scene import shown_instances
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

SETTINGS = RenderSettings(device=DEVICE, sample_count=2, bounce_max=3)
# Instances of the scene: two boxes that are placed once and lie in world space, and two of one mesh
FIRST, SECOND, SHARED, SHARED_TOO = range(4)


def turned(angle, x, y, z):
    matrix = np.array(scenes.translation(x, y, z), np.float32)
    matrix[:, :3] = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    return matrix


@pytest.fixture(scope="module")
def start():
    box, smooth = scenes.box(), scenes.box()
    normals = smooth.positions[smooth.triangles]
    smooth = replace(smooth, corner_normals=(normals / np.linalg.norm(normals, axis=-1, keepdims=True)))
    made = scenes.scene(
        [
            (smooth, turned(0.3, -1.5, 1, 0), scenes.diffuse()),
            (box, turned(0.7, 0, 4, -1), scenes.diffuse()),
            (scenes.box(), scenes.translation(1.5, 1, 0), scenes.diffuse()),
        ],
        view=scenes.camera(eye=(0, -5, 1)),
        frame=Frame(12, 10),
    )
    instances = made.instances

    def doubled(values):
        return None if values is None else np.concatenate([values, values[-1:]])

    more = {name: doubled(getattr(instances, name)) for name in ("mesh", "transform", "visibility", "slot_first")}
    made = replace(made, instances=replace(instances, **more), object_names=())
    for mesh in made.meshes:
        for array in (mesh.positions, mesh.triangles, mesh.triangle_slot, mesh.corner_normals, mesh.corner_uvs):
            if array is not None:
                freeze(array)
    return placed(made, {SHARED_TOO: turned(0.2, 2.5, 3, 0.5)})


def placed(scene, maps):
    transform = np.array(scene.instances.transform)
    for instance, each in maps.items():
        transform[instance] = each
    return replace(scene, instances=replace(scene.instances, transform=transform))


@pytest.fixture
def flattened(monkeypatch):
    """Whether all geometry was looked at, by frame."""
    calls = []
    monkeypatch.setattr(shown_instances, "flatten", lambda *of: (calls.append(1), flatten(*of))[1])
    return calls


def assert_as_new(session, scene, **changes):
    settings = SETTINGS.replace(**changes)
    film, expected = session.render(scene, settings), Session(DEVICE).render(scene, settings)
    assert film.passes["Combined"].tobytes() == expected.passes["Combined"].tobytes()
    last = session._at[0].cache._last
    flat, geometry = flatten(scene, last.shows.groups), last.geometry
    for name in ("positions", "corner_normals", "instance_transform"):
        assert np.array_equal(getattr(geometry, name).numpy(), getattr(flat, name)), name
    return film


MOVES = {
    "in world space": {FIRST: turned(0.5, -1.4, 1.1, 0.2)},
    "to where it needs no map": {FIRST: np.eye(3, 4, dtype=np.float32)},
    "shared": {SHARED: scenes.translation(1.2, 1.5, 0.1)},
    "all": {FIRST: turned(0.2, -1, 1, 0), SECOND: turned(0.1, 0.1, 4, -1), SHARED_TOO: turned(0.1, 2, 3, 0)},
    "squeezed": {SECOND: np.float32([[1.1, 0, 0, 0], [0, 1.0, 0.1, 4], [0, 0, 0.9, -1]])},
}


@pytest.mark.parametrize("move", MOVES)
@pytest.mark.parametrize("batching", ["OFF", "ON"])
def test_no_other_geometry_is_looked_at_and_the_film_is_that_of_a_new_session(
    start, flattened, monkeypatch, move, batching
):
    monkeypatch.setattr(mesh_tree, "SAH_GROWTH_MAX", 1e9)  # a tree of a few boxes may get worse by much
    session, there = Session(DEVICE), placed(start, MOVES[move])
    session.render(start, SETTINGS.replace(batching=batching, spatial_splits="OFF"))
    flattened.clear()
    session.render(there, SETTINGS.replace(batching=batching, spatial_splits="OFF"))
    assert not flattened
    film = assert_as_new(session, there, batching=batching, spatial_splits="OFF")
    assert film.statistics["tree"]["built"] == 0
    assert_as_new(session, start, batching=batching, spatial_splits="OFF")


def test_what_moved_is_found_again_by_who_looks_at_all(start, flattened):
    """The digests of the frame before are not those of what is there."""
    session, there = Session(DEVICE), placed(start, MOVES["all"])
    session.render(start, SETTINGS.replace(spatial_splits="OFF"))
    session.render(there, SETTINGS.replace(spatial_splits="OFF"))
    # other arrays with the same numbers: all is looked at, and equals the first frame
    other = replace(start, meshes=tuple(replace(each, positions=each.positions.copy()) for each in start.meshes))
    flattened.clear()
    session.render(other, SETTINGS.replace(spatial_splits="OFF"))
    assert len(flattened) == 1
    assert_as_new(session, other, spatial_splits="OFF")


@pytest.mark.parametrize("why", ["mirrored", "bad", "arrays that may change", "another mesh", "hidden"])
def test_all_is_looked_at_where_more_than_places_changed(start, flattened, monkeypatch, why):
    session, scene = Session(DEVICE), start
    there = placed(start, MOVES["in world space"])
    if why == "mirrored":
        there = placed(start, {FIRST: np.float32([[-1, 0, 0, -1.5], [0, 1, 0, 1], [0, 0, 1, 0]])})
    elif why == "bad":  # no tree is good enough
        monkeypatch.setattr(mesh_tree, "SAH_GROWTH_MAX", 0.0)
    elif why == "arrays that may change":
        scene = replace(start, meshes=tuple(replace(each, positions=each.positions.copy()) for each in start.meshes))
        there = replace(there, meshes=scene.meshes)
    elif why == "another mesh":
        first = replace(start.meshes[0], positions=freeze(start.meshes[0].positions * np.float32(0.5)))
        there = replace(there, meshes=(first, *there.meshes[1:]))
    else:
        seen = np.array(there.instances.visibility)
        seen[SECOND] = 0
        there = replace(there, instances=replace(there.instances, visibility=seen))
    session.render(scene, SETTINGS.replace(spatial_splits="OFF"))
    flattened.clear()
    film = session.render(there, SETTINGS.replace(spatial_splits="OFF"))
    # trees follow where there are as many triangles, nearly all of the same vertices in the same order
    is_built = why in ("bad", "hidden", "mirrored")
    assert len(flattened) == 1 and (film.statistics["tree"]["built"] > 0) == is_built
    assert_as_new(session, there, spatial_splits="OFF")
