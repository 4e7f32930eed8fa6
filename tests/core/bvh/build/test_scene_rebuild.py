"""Trees that do not follow what changed are built anew: another topology or other settings, bad trees, splits."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.bvh.build import mesh_tree
from raybatch_addon.core.bvh.node import Layout
from raybatch_addon.core.scene.description import Mesh
from raybatch_addon.core.session import Session
from raybatch_addon.core.wavefront.plan import cost_model
from tests.core.bvh.build.refit_scenes import (
    FLOOR,
    FRAME,
    NOT_CAMERA,
    SETTINGS,
    assert_same,
    counts,
    layouts,
    opened,
    several,
    turned,
)
from tests.support import scenes, wide_trees
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")


def with_object(scene, index, **changes):
    instances = {name: getattr(scene.instances, name).copy() for name in changes}
    for name, value in changes.items():
        instances[name][index] = value
    return replace(scene, instances=replace(scene.instances, **instances))


def without_last_object(scene):
    return replace(
        scene,
        instances=replace(scene.instances, **{k: v[:-1] for k, v in vars(scene.instances).items() if v is not None}),
    )


def without_last_triangle(scene):
    mesh = scene.meshes[1]
    return replace(
        scene,
        meshes=(scene.meshes[0], replace(mesh, triangles=mesh.triangles[:-1], corner_normals=None), *scene.meshes[2:]),
    )


def with_other_triangles(scene):
    mesh = scene.meshes[0]
    return replace(scene, meshes=(replace(mesh, triangles=mesh.triangles[::-1].copy()), *scene.meshes[1:]))


def with_quads_cut_anew(scene):
    """The quad of the floor along its other diagonal."""
    mesh = scene.meshes[0]
    a, b, c, d = (mesh.triangles[0::2, 0], mesh.triangles[0::2, 1], mesh.triangles[0::2, 2], mesh.triangles[1::2, 2])
    assert (mesh.triangles[1::2, 0] == a).all() and (mesh.triangles[1::2, 1] == c).all(), "quads are fans"
    cut = np.stack([np.stack([a, b, d], 1), np.stack([b, c, d], 1)], 1).reshape(-1, 3)
    meshes = list(scene.meshes)
    meshes[0] = replace(mesh, triangles=cut.astype(np.int32))
    return replace(scene, meshes=tuple(meshes))


@pytest.mark.parametrize(
    "change",
    [
        without_last_triangle,
        lambda scene: with_object(scene, 2, visibility=NOT_CAMERA),
        lambda scene: with_object(scene, 6, visibility=NOT_CAMERA),
        lambda scene: with_object(scene, 6, mesh=4),
        without_last_object,
    ],
    ids=["fewer triangles", "baked hidden", "instance hidden", "other mesh", "fewer instances"],
)
def test_another_topology_is_built_anew(change):
    session = Session(DEVICE, SETTINGS)
    session.render(several(0.5))
    film = session.render(change(several(0.5)))
    tree = film.statistics["tree"]
    assert counts(tree) == (tree["trees"], 0)
    assert_same(film, Session(DEVICE, SETTINGS).render(change(several(0.5))))


@pytest.mark.parametrize(
    "change",
    [
        with_other_triangles,
        with_quads_cut_anew,
        lambda scene: with_object(scene, 1, transform=turned(0.3, -1.2, 0, 0) * np.array([[-1], [1], [1]])),
    ],
    ids=["in another order", "cut anew", "mirrored"],
)
def test_as_many_triangles_over_other_vertices_are_followed(change):
    """A quad that bends is cut along its other diagonal: trees know triangles by their number alone."""
    session = Session(DEVICE, SETTINGS)
    session.render(several(0.5))
    film = session.render(change(several(0.7)))
    tree = film.statistics["tree"]
    assert sum(counts(tree)) > 0 and counts(tree)[0] < tree["trees"]
    assert_same(film, Session(DEVICE, SETTINGS).render(change(several(0.7))))
    assert_same(session.render(several(0.5)), Session(DEVICE, SETTINGS).render(several(0.5)))


def test_a_tree_is_followed_only_while_it_is_as_good(monkeypatch):
    """Triangles in any other order are one too, until their tree costs too much."""
    session, other = Session(DEVICE, SETTINGS), with_other_triangles(several(0.5))
    session.render(several(0.5))
    monkeypatch.setattr(mesh_tree, "SAH_GROWTH_MAX", 0.0)
    film = session.render(other)
    assert counts(film.statistics["tree"])[0] > 0
    assert_same(film, Session(DEVICE, SETTINGS).render(other))


def test_other_settings_of_the_tree_build_it_anew():
    session = Session(DEVICE, SETTINGS)
    expected = session.render(several(0.5))
    splits = session.render(several(0.5), SETTINGS.replace(spatial_splits="ON"))
    assert counts(splits.statistics["tree"]) == (4, 0)
    assert_same(splits, expected)
    assert session.render(several(0.5), SETTINGS.replace(batching="REFERENCE")).statistics["tree"] is None
    film = session.render(several(0.5))
    assert counts(film.statistics["tree"]) == (4, 0)
    assert_same(film, expected)


def soup_scene(positions: np.ndarray, triangles: np.ndarray, copies: int = 1):
    mesh = Mesh("soup", positions, triangles)
    objects = [(mesh, scenes.translation(1.5 * i, 0, 0), scenes.diffuse(0.7)) for i in range(copies)]
    return scenes.scene([*objects, (FLOOR, scenes.translation(0, 0, -1), scenes.diffuse(0.5))], frame=FRAME, world=0.5)


@layouts
@pytest.mark.parametrize("copies", [1, 2], ids=["baked", "instances"])
def test_a_tree_that_became_bad_is_built_anew(layout, copies):
    positions, triangles = wide_trees.soup(500)
    session = opened(layout)
    first = session.render(soup_scene(positions, triangles, copies)).statistics["tree"]
    assert first["sah"] == first["sah_built"] > 0
    shaken = (positions + 0.02 * np.sin(40 * positions)).astype(np.float32)
    tree = session.render(soup_scene(shaken, triangles, copies)).statistics["tree"]
    assert counts(tree) == (0, 1) and tree["sah"] != first["sah"]
    assert tree["sah_built"] == min(first["sah"], tree["sah"])
    mixed = positions[
        np.random.default_rng(0).permutation(len(positions) // 3)[triangles // 3] * 3 + np.arange(3)
    ].reshape(-1, 3)
    film = session.render(soup_scene(mixed, triangles, copies))
    tree = film.statistics["tree"]
    assert counts(tree) == (1, 0) and tree["sah"] == tree["sah_built"] < 1.4 * first["sah"]
    assert_same(film, opened(layout).render(soup_scene(mixed, triangles, copies)))


def quads(count: int, flipped: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of count x count quads, the first `flipped` of them cut along their other diagonal."""
    x, y = np.meshgrid(np.linspace(-1, 1, count + 1), np.linspace(-1, 1, count + 1))
    a = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    b, c, d = a + 1, a + count + 2, a + count + 1
    cut = np.stack([a, b, c, a, c, d], 1)
    cut[:flipped] = np.stack([a, b, d, b, c, d], 1)[:flipped]
    positions = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    return positions.astype(np.float32), cut.reshape(-1, 3).astype(np.int32)


@layouts
@pytest.mark.parametrize("copies", [1, 2], ids=["baked", "instances"])
def test_another_mesh_of_as_many_triangles_is_built_anew(layout, copies):
    """What a tree of triangles in disorder costs is no measure of a tidy one."""
    tidy, triangles = quads(30)
    generator = np.random.default_rng(2)
    disorder = generator.uniform(-1, 1, tidy.shape).astype(np.float32), generator.permuted(triangles, axis=0)
    session = opened(layout)
    bad = session.render(soup_scene(*disorder, copies)).statistics["tree"]
    film = session.render(soup_scene(tidy, triangles, copies))
    tree, fresh = film.statistics["tree"], opened(layout).render(soup_scene(tidy, triangles, copies))
    assert counts(tree) == (1, 0)
    assert tree["sah"] == tree["sah_built"] == fresh.statistics["tree"]["sah"] < 0.2 * bad["sah"]
    assert_same(film, fresh)


@layouts
@pytest.mark.parametrize("copies", [1, 2], ids=["baked", "instances"])
def test_a_mesh_of_which_few_quads_are_cut_anew_is_refitted(layout, copies):
    session = opened(layout)
    session.render(soup_scene(*quads(30), copies))
    film = session.render(soup_scene(*quads(30, flipped=20), copies))
    assert counts(film.statistics["tree"]) == (0, 1)
    assert_same(film, opened(layout).render(soup_scene(*quads(30, flipped=20), copies)))


@layouts
def test_a_tree_is_measured_by_the_best_that_it_was(layout):
    """Triangles that shrink and grow again: their tree costs no more than at first, and could cost far less."""
    positions, triangles = wide_trees.soup(500)
    middle = np.repeat(positions.reshape(-1, 3, 3).mean(1), 3, axis=0)
    large = (middle + 5 * (positions - middle)).astype(np.float32)
    session, work = opened(layout), []
    for each in (large, positions, large):
        tree = session.render(soup_scene(each, triangles)).statistics["tree"]
        work.append(counts(tree))
    assert work == [(1, 0), (0, 1), (1, 0)]


@pytest.fixture
def splits_pay(monkeypatch):
    """Splits are worth it however short the render is."""
    monkeypatch.setattr(cost_model, "SPLIT_NS", 0.0)


@pytest.mark.skipif(DEVICE != "cpu", reason="boxes are for CPUs")
def test_what_moves_is_built_without_splits_once_and_followed_from_then_on(splits_pay, monkeypatch):
    positions, triangles = wide_trees.needles(500)
    session = opened(Layout.BOXES)
    session.settings = SETTINGS.replace(spatial_splits="AUTO")
    work, reported = [], []
    for frame in range(4):
        moved = (positions + 0.002 * frame * np.sin(40 * positions)).astype(np.float32)
        film = session.render(soup_scene(moved, triangles))
        work.append(counts(film.statistics["tree"]))
        assert_same(film, opened(Layout.BOXES).render(soup_scene(moved, triangles)))
        reported.append(film.statistics["auto"]["spatial_splits"])
    assert work == [(1, 0), (1, 0), (0, 1), (0, 1)]
    assert [each["value"] for each in reported] == ["ON", "OFF", "OFF", "OFF"]
    assert reported[1]["why"] == "1 of 1 trees follow vertices that moved, which split nothing"
    monkeypatch.setattr(cost_model, "SPLIT_NS", 1e9)
    film = session.render(soup_scene(moved, triangles))
    assert film.statistics["auto"]["spatial_splits"]["value"] == "OFF", "an earlier render left none"


def test_split_triangles_are_split_anew():
    """What was split is worth it for its own positions only."""
    positions, triangles = wide_trees.needles(500)
    settings = SETTINGS.replace(spatial_splits="ON")
    session = Session(DEVICE, settings)
    scene = soup_scene(positions, triangles)
    first = session.render(scene).statistics["tree"]
    shaken = soup_scene((positions + 0.001 * np.sin(40 * positions)).astype(np.float32), triangles)
    film = session.render(shaken)
    tree = film.statistics["tree"]
    assert counts(tree) == (1, 0) and tree["sah"] == pytest.approx(first["sah"], rel=0.05)
    assert_same(film, Session(DEVICE, SETTINGS).render(shaken))
    assert counts(session.render(shaken).statistics["tree"]) == (0, 0)


@pytest.mark.skipif(DEVICE != "cpu", reason="boxes are for CPUs")
def test_a_tree_without_splits_is_for_short_renders_and_one_with_splits_for_all(monkeypatch):
    positions, triangles = wide_trees.needles(500)
    scene = soup_scene(positions, triangles)
    session = opened(Layout.BOXES)
    session.settings = SETTINGS.replace(spatial_splits="AUTO")
    done = []
    for nanoseconds in (1e9, 1e9, 0.0, 1e9):  # a triangle: renders are short, short, long, short
        monkeypatch.setattr(cost_model, "SPLIT_NS", nanoseconds)
        film = session.render(scene)
        done.append((counts(film.statistics["tree"]), film.statistics["auto"]["spatial_splits"]["value"]))
        assert_same(film, opened(Layout.BOXES).render(scene))
    assert done == [((1, 0), "OFF"), ((0, 0), "OFF"), ((1, 0), "ON"), ((0, 0), "ON")]
    assert "earlier render" in film.statistics["auto"]["spatial_splits"]["why"]
