"""What a device gets anew by kind of edit, in bytes and launches, and that every film is that of a new session."""

import pytest

from raybatch_addon.core.bvh.build import mesh_tree
from raybatch_addon.core.bvh.build.mesh_tree import MeshTrees
from raybatch_addon.core.programs.table import encode
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.scene.device_scene import DeviceScene
from tests.core.wavefront.scene.edited import EDITS, MATERIALS, edited_scene
from tests.core.wavefront.scene.uploads import counted_uploads
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")

SETTINGS = RenderSettings(device=DEVICE, sample_count=1, bounce_max=2, spatial_splits="OFF")
# Records of lamps, the sky and the camera, and the table of the choice among emitters: they depend on no scene's size
SMALL = 2_000
# Bytes of a vertex and of a triangle's slot; and of an instance: its map, its first slot and its share of the top level
VERTEX, TRIANGLE, INSTANCE = 12, 4, 48 + 4 + 64
MAPS = 2 * 48  # of an instance, from and to the world, for programs that read places
# Bytes of an emitter in what the tree over emitters is made of (its box twice, in the second with those of nodes, its
# leaf, two binary nodes, three numbers), and a block of the tree, of which there are fewer than emitters
EMITTER = 24 + 48 + 48 + 2 * 60 + 12
BLOCK = 16 * (12 * 4 + 4) + 4
# Kernels that look at emitters again: their brightness, and the tree over them
OF_EMITTERS = ("_kernel_of_all", "estimate", "bound_triangles_kernel")
KEEPS_EMITTERS = ("camera", "value", "graph", "place", "place in world space", "world", "mesh", "visibility")
KEEPS_EMITTERS += ("visibility in world space", "visibility of an emitter")  # there is none to look at then


@pytest.fixture
def edit_of(monkeypatch):
    """What edits cost a session that has rendered a scene: (bytes, kernels that were launched)."""
    monkeypatch.setattr(mesh_tree, "SAH_GROWTH_MAX", 1e9)  # a tree of few triangles may get worse by much
    counted, build, found = counted_uploads(monkeypatch), DeviceScene.build, []

    def counting(*of, **more):
        counted.clear()
        made = build(*of, **more)
        found.append((counted.bytes, set(counted.launches)))
        return made

    monkeypatch.setattr(DeviceScene, "build", staticmethod(counting))

    def cost(scene, kind):
        session, edited = Session(DEVICE), EDITS[kind](scene)
        session.render(scene, SETTINGS)
        film = session.render(edited, SETTINGS)
        spent, back = found[-1], session.render(scene, SETTINGS)
        for each, of in ((film, edited), (back, scene)):
            fresh = Session(DEVICE).render(of, SETTINGS)
            assert each.passes["Combined"].tobytes() == fresh.passes["Combined"].tobytes()
        return spent

    return cost


@pytest.mark.parametrize("reads_places", [False, True])
@pytest.mark.parametrize("kind", EDITS)
def test_an_edit_uploads_what_it_changes(edit_of, kind, reads_places):
    small, kernels = edit_of(edited_scene(reads_places=reads_places), kind)
    looks_at_emitters = any(name.startswith(OF_EMITTERS) for name in kernels)
    assert looks_at_emitters == (kind not in KEEPS_EMITTERS)
    if kind in ("camera", "value", "world"):
        assert small < SMALL and not kernels
        large, _ = edit_of(edited_scene(grid=30, balls=90, reads_places=reads_places), kind)
        assert large == small, "whatever the size of the scene"


def programs_bytes(scene):
    """Of all programs of surfaces."""
    programs = [material.program for material in scene.materials]
    return sum(each.nbytes for each in encode(programs, sorted({op for each in programs for op in each.ops})))


def vertices_bytes(scene):
    """Of all vertices and slots of triangles, whichever mesh moved, and of instances."""
    reads_places = any("object_coordinates" in each.program.ops for each in scene.materials)
    of_meshes = sum(VERTEX * len(mesh.positions) + TRIANGLE * len(mesh.triangles) for mesh in scene.meshes)
    return of_meshes + (INSTANCE + reads_places * MAPS) * len(scene.instances)


def emitters_bytes(scene):
    """Of the choice among emitters: of them alone, whatever else there is."""
    shines = [material.program.may_emit for material in scene.materials]
    count = len(scene.lights) + sum(shines[slot] for slot in scene.meshes[0].triangle_slot)
    return count * (EMITTER + BLOCK)


@pytest.mark.parametrize("reads_places", [False, True])
@pytest.mark.parametrize("kind, most", [("graph", programs_bytes), ("mesh", vertices_bytes), ("light", emitters_bytes)])
def test_an_edit_uploads_no_more_than_what_it_may_change(edit_of, kind, most, reads_places):
    for grid, balls in ((8, 30), (40, 30), (8, 230)):
        scene = edited_scene(grid=grid, balls=balls, reads_places=reads_places)
        spent, kernels = edit_of(scene, kind)
        assert spent <= SMALL + most(EDITS[kind](scene)), (grid, balls)
        assert kind != "graph" or not kernels


@pytest.mark.parametrize("reads_places", [False, True])
@pytest.mark.parametrize("kind", ["place", "place in world space"])
def test_a_moved_instance_uploads_its_maps_and_the_top_level(edit_of, kind, reads_places):
    """The top level is built anew: nodes and an order, by instance. No other instance's maps are uploaded, nor what
    programs read of triangles.
    """
    few, many = (edit_of(edited_scene(grid=8, balls=count, reads_places=reads_places), kind)[0] for count in (30, 230))
    assert (many - few) / 200 < 64
    larger, _ = edit_of(edited_scene(grid=40, balls=30, reads_places=reads_places), kind)
    assert larger == few, "whatever the count of triangles"


@pytest.mark.parametrize("kind", ["visibility", "visibility in world space"])
def test_what_is_hidden_builds_no_tree_but_the_top_level(monkeypatch, kind):
    """Elsewhere than on a CPU trees are built in no time."""
    built, build = [], MeshTrees.build
    monkeypatch.setattr(MeshTrees, "build", lambda trees, part: built.append(part) or build(trees, part))
    session, scene = Session(DEVICE), edited_scene()
    session.render(scene, SETTINGS)
    assert len(built) == 2
    for each in (EDITS[kind](scene), scene):
        built.clear()
        session.render(each, SETTINGS)
        assert not built or session.device.is_cuda


def test_an_instance_that_is_hidden_uploads_of_triangles_what_shines(edit_of):
    """These have other instances, by number."""
    few, larger = (edit_of(edited_scene(grid=grid), "visibility")[0] for grid in (8, 40))
    emissive = 2 * 40**2 // MATERIALS
    assert larger - few <= 24 * emissive or Session(DEVICE).device.is_cuda
