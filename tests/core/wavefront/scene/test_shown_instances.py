"""Frames that show other instances than those before: which trees are built, and that every film is a new session's."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.bvh.build import mesh_tree
from raybatch_addon.core.scene.description import Frame
from raybatch_addon.core.scene.frozen import freeze
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.core.wavefront.scene.keeping import frozen_meshes
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")

SETTINGS = RenderSettings(device=DEVICE, sample_count=2, bounce_max=3)
# Balls with a mesh each, of as many triangles as only they have; and one more that is placed twice
BALLS = [
    frozen_meshes(scenes.scene([(scenes.sphere(segments=6 + i, rings=5), scenes.IDENTITY, None)])).meshes[0]
    for i in range(9)
]
TWIN = frozen_meshes(scenes.scene([(scenes.sphere(segments=5, rings=4), scenes.IDENTITY, None)])).meshes[0]
TWINS = ("twin a", "twin b")


class Stage:
    """Objects by name: a mesh, and where it is."""

    def __init__(self, count=7, twins=False):
        self.parts = {
            f"ball {i}": (BALLS[i], scenes.translation(1.2 * (i % 3) - 1.2, 1.0 * (i // 3), 0, 0.5))
            for i in range(count)
        }
        if twins:
            self.parts |= {name: (TWIN, scenes.translation(i - 0.5, -1, 0.6, 0.4)) for i, name in enumerate(TWINS)}

    def scene(self, hidden=()):
        shown = {name: part for name, part in self.parts.items() if name not in hidden}
        parts = [(mesh, place, scenes.diffuse(0.3 + 0.05 * (len(name) % 7))) for name, (mesh, place) in shown.items()]
        made = scenes.scene(parts, view=scenes.camera(eye=(0, -6, 1)), frame=Frame(16, 12), world=0.3)
        lamp = scenes.area_light(matrix=scenes.translation(0, -1, 4))
        return replace(made, lights=(lamp,), object_names=tuple(shown))


class Renders:
    """Renders of one session, each held against one of a session of its own."""

    def __init__(self, **changes):
        self.session, self.settings = Session(DEVICE), SETTINGS.replace(**changes)
        self.follows = self.session.device.is_cpu  # elsewhere trees are built in no time

    def __call__(self, scene):
        """Trees that were built and refitted for `scene`."""
        film, fresh = (each.render(scene, self.settings) for each in (self.session, Session(DEVICE)))
        assert film.passes["Combined"].tobytes() == fresh.passes["Combined"].tobytes()
        tree = film.statistics["tree"]
        assert tree["triangles"] == fresh.statistics["tree"]["triangles"]
        return tree["built"], tree["refitted"]


@pytest.fixture(params=[False, True], ids=["one tree", "twins"])
def twins(request):
    return request.param


def test_hiding_and_showing_builds_no_tree(twins):
    render, stage = Renders(), Stage(twins=twins)
    render(stage.scene())
    for hidden in (["ball 1"], ["ball 1", "ball 4"], ["ball 4"], [], ["ball 0", "ball 2"], []):
        assert render(stage.scene(hidden)) == (0, 0) or not render.follows


def test_the_same_mesh_that_was_read_again_gets_its_place():
    render, stage = Renders(), Stage()
    render(stage.scene())
    assert render(stage.scene(["ball 2"])) == (0, 0) or not render.follows
    mesh, place = stage.parts["ball 2"]
    again = replace(mesh, positions=freeze(mesh.positions.copy()), triangles=freeze(mesh.triangles.copy()))
    stage.parts["ball 2"] = again, place
    assert render(stage.scene()) == (0, 0) or not render.follows


def test_what_was_moved_while_it_was_hidden_is_refitted(monkeypatch, twins):
    monkeypatch.setattr(mesh_tree, "SAH_GROWTH_MAX", 1e9)  # a tree of few triangles may get worse by much
    render, stage = Renders(), Stage(twins=twins)
    render(stage.scene())
    render(stage.scene(["ball 2"]))
    stage.parts["ball 2"] = stage.parts["ball 2"][0], scenes.translation(0.3, -1.5, 0.4, 0.5)
    assert render(stage.scene()) == (0, 1) or not render.follows


def test_what_comes_back_to_a_tree_that_was_refitted_meanwhile_is_met(monkeypatch, twins):
    monkeypatch.setattr(mesh_tree, "SAH_GROWTH_MAX", 1e9)
    render, stage = Renders(), Stage(twins=twins)
    render(stage.scene())
    render(stage.scene(["ball 2"]))
    stage.parts["ball 5"] = stage.parts["ball 5"][0], scenes.translation(1.5, -0.5, 0.4, 0.5)
    assert render(stage.scene(["ball 2"])) == (0, 1)
    assert render(stage.scene()) == (0, 1) or not render.follows
    assert render(stage.scene(["ball 5"])) == (0, 0) or not render.follows


def test_what_is_new_has_a_tree_beside_the_others():
    """Where there is a tree over trees: without one all are built anew."""
    render, stage = Renders(), Stage(count=6, twins=True)
    render(stage.scene())
    stage.parts["new"] = BALLS[7], scenes.translation(0, -2, 0.5, 0.4)
    assert render(stage.scene()) == (1, 0) or not render.follows
    assert render(stage.scene(["ball 3"])) == (0, 0) or not render.follows
    _, place = stage.parts["ball 1"]
    stage.parts["ball 1"] = BALLS[8], place  # with other triangles
    assert render(stage.scene()) == (1, 0) or not render.follows
    assert render(stage.scene(["new"])) == (0, 0) or not render.follows


def test_one_of_two_that_share_a_mesh_lies_in_the_world_then():
    render, stage = Renders(), Stage(twins=True)
    render(stage.scene())
    for hidden in (TWINS[:1], (), TWINS, ("ball 1", TWINS[1]), ()):
        render(stage.scene(hidden))


def test_most_that_goes_and_comes_builds_all_anew(twins):
    render, stage = Renders(), Stage(twins=twins)
    render(stage.scene())
    most = [f"ball {i}" for i in range(1, 7)]
    assert render(stage.scene(most))[0] >= 1
    assert render(stage.scene())[0] >= 1


def test_many_that_come_one_after_the_other_are_joined():
    render, stage = Renders(), Stage(count=9, twins=True)
    render(stage.scene())
    for i in range(12):
        mesh = replace(TWIN, positions=freeze(TWIN.positions * np.float32(1 + 0.01 * i)))
        stage.parts[f"new {i}"] = mesh, scenes.translation(0.3 * i - 2, -2, 0.5, 0.1)
        assert render(stage.scene()) == (1, 0) or not render.follows
    assert len(render.session._at[0].cache._last.shows.groups) <= 8 or not render.follows


def test_meshes_that_may_change_are_built_anew():
    render, stage = Renders(), Stage()
    stage.parts = {
        name: (replace(mesh, positions=mesh.positions.copy()), place) for name, (mesh, place) in stage.parts.items()
    }
    render(stage.scene())
    assert render(stage.scene(["ball 1"])) == (1, 0)


def test_renders_that_are_worth_better_trees_get_them():
    render, stage = Renders(spatial_splits="ON"), Stage()
    render(stage.scene())
    assert render(stage.scene(["ball 1"])) == (1, 0)


def test_any_edits_after_each_other(twins):
    """Hide, show, move, reshape and replace at random."""
    random, render, stage, hidden = np.random.default_rng(5), Renders(), Stage(twins=twins), set()
    render(stage.scene())
    for _ in range(24):
        for name in random.choice(sorted(stage.parts), random.integers(1, 3), replace=False).tolist():
            mesh, place = stage.parts[name]
            match random.integers(0, 5):
                case 0 | 1:
                    hidden ^= {name}
                case 2:
                    stage.parts[name] = mesh, place + random.normal(0, 0.05, (3, 4)).astype(np.float32)
                case 3 if name not in TWINS:
                    stage.parts[name] = replace(mesh, positions=freeze(mesh.positions * np.float32(1.05))), place
                case 4 if name not in TWINS:
                    stage.parts[name] = BALLS[random.integers(len(BALLS))], place
        if len(hidden) > 4:
            hidden.clear()
        render(stage.scene(hidden))
