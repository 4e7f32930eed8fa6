"""Shadow catchers: what films show of them in closed form, and that no schedule changes a bit."""

import dataclasses

import numpy as np
import pytest
from checking.films import FilmComparer
from checking.schedules import SeededDraws

from raybatch_addon.core.film import Film
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Scene, Visibility
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.linking import catchers
from raybatch_addon.core.scene.passes import (
    CATCHER_PASS,
    CATCHER_SHADOWS,
    COLOR_PASSES,
    DIRECT_PASSES,
    INDIRECT_PASSES,
    SEEN_PASSES,
)
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes, schedule_scenes
from tests.support.feature_scenes import CATCHES

pytestmark = pytest.mark.usefixtures("general_kernels")

UNSEEN = int(Visibility.ALL & ~Visibility.CAMERA)
ONCE = RenderSettings(sample_count=4, bounce_max=0)
LIGHT = (*DIRECT_PASSES, *INDIRECT_PASSES, *COLOR_PASSES, *SEEN_PASSES)


def frame(*passes: str, transparent: bool = True, size: int = 16) -> Frame:
    return Frame(size, size, passes=("Combined", *passes), transparent=transparent)


def ground(shown: Frame, *objects, floor=None, lights=None) -> Scene:
    """A floor that fills the picture and catches the shadow of a sheet above its left half, which nobody sees; below a
    sun, before a world that the camera alone sees.
    """
    sheet = scenes.plane("sheet", 4.0), scenes.translation(-2, 0, 1), scenes.diffuse(), UNSEEN
    made = scenes.scene(
        [(scenes.plane("floor", 4.0), scenes.IDENTITY, floor or scenes.diffuse(), CATCHES), sheet, *objects],
        view=scenes.camera(eye=(0, 0, 3), half_width=0.3, up=(0, 1, 0)),
        frame=shown,
        lights=[scenes.sun(2.0)] if lights is None else lights,
        world=(0.2, 0.4, 0.8),
    )
    return dataclasses.replace(made, world=dataclasses.replace(made.world, visibility=int(Visibility.CAMERA)))


def halves(film: Film, name: str) -> tuple[np.ndarray, np.ndarray]:
    """A pass below the sheet and beside it, without the column between."""
    values = film.passes[name]
    return values[:, :7], values[:, 9:]


def test_the_pass_is_light_over_light_without_other_objects(session):
    film = session.render(ground(frame(CATCHER_PASS)), ONCE)
    below, beside = halves(film, CATCHER_PASS)
    assert not below.any() and (beside == 1).all()
    assert not film.passes["Combined"].any()  # what catches is not shown, and covers nothing
    assert film.statistics["invalid_samples"] == 0


def test_shadows_lie_on_a_transparent_film_and_before_a_world(session):
    film = session.render(ground(frame(CATCHER_SHADOWS)), ONCE)
    below, beside = halves(film, "Combined")
    assert (below == (0, 0, 0, 1)).all() and not beside.any()
    below, beside = halves(film, CATCHER_SHADOWS)
    assert (below == 1).all() and not beside.any()
    film = session.render(ground(frame(CATCHER_SHADOWS, transparent=False)), ONCE)
    below, beside = halves(film, "Combined")
    assert (below == (0, 0, 0, 1)).all()
    assert np.allclose(beside, (0.2, 0.4, 0.8, 1))  # the world behind the floor


def test_beside_its_pass_a_catcher_is_a_hole_before_a_world(session):
    film = session.render(ground(frame(CATCHER_PASS, "Environment", transparent=False)), ONCE)
    assert not film.passes["Combined"].any()
    assert np.allclose(film.passes["Environment"], (0.2, 0.4, 0.8))


def test_a_catcher_that_lets_light_through_catches_as_much_as_it_covers(session):
    """Cycles counts what comes through twice, so that such a catcher shows too little."""
    veil = scenes.material(Closure(ClosureKind.TRANSPARENT, (0.5,) * 3), Closure(ClosureKind.DIFFUSE, (0.5,) * 3))
    film = session.render(ground(frame(CATCHER_SHADOWS), floor=veil), ONCE.replace(sample_count=256))
    below, beside = halves(film, "Combined")
    assert below[..., 3].mean() == pytest.approx(0.5, abs=0.01) and not below[..., :3].any()
    assert not beside.any()


def test_what_is_no_catcher_brightens_it(session):
    """Light of a surface is among what is there besides catchers; that of lamps is not."""
    lamp = scenes.plane("lamp", 0.5), scenes.translation(1.5, 0, 1.0), scenes.emitter(8.0), UNSEEN
    shown = session.render(ground(frame(CATCHER_PASS), lamp), ONCE.replace(sample_count=64)).passes[CATCHER_PASS]
    assert shown[:, 9:].min() > 1.05 and shown[:, :7].mean() < 1
    without_sun = ground(frame(CATCHER_PASS), lamp, lights=[])
    assert (session.render(without_sun, ONCE).passes[CATCHER_PASS] == 1).all()  # no light to compare with


def test_light_passes_are_of_what_combined_shows(session):
    ball = scenes.sphere("ball", 24, 12), scenes.translation(0.3, 0, 0.6, 0.4), scenes.diffuse((0.8, 0.3, 0.1))
    film = session.render(ground(frame(CATCHER_PASS, *LIGHT), ball), RenderSettings(sample_count=8, bounce_max=3))
    seen, passes = film.passes["Combined"], film.passes
    total = passes["Emission"].astype(float)
    for direct, indirect, color in zip(DIRECT_PASSES, INDIRECT_PASSES, COLOR_PASSES):
        total += (passes[direct].astype(float) + passes[indirect]) * passes[color]
    assert seen[..., :3].max() > 0.05 and 0 < seen[..., 3].mean() < 0.5
    assert np.allclose(total, seen[..., :3], atol=1e-6)


def still_life() -> Scene:
    """Catchers of several kinds, one of them luminous, and what throws shadows on them, lets light through or cuts
    holes; in a film with all kinds of passes.
    """
    veil = scenes.material(
        Closure(ClosureKind.TRANSPARENT, (0.7, 0.6, 0.5)), Closure(ClosureKind.DIFFUSE, (0.1, 0.2, 0.2)), name="veil"
    )
    glass = scenes.material(Closure(ClosureKind.GLASS, (0.9, 1.0, 0.9), ior=1.45), name="glass")
    hole = scenes.material(Closure(ClosureKind.HOLDOUT, (1.0,) * 3), name="hole")
    ball = scenes.sphere("ball", 14, 7)
    return scenes.scene(
        [
            (scenes.plane("floor", 8), scenes.translation(0, 0, -1), scenes.diffuse((0.7, 0.6, 0.5)), CATCHES),
            (scenes.plane("mat", 2), scenes.translation(1.2, -1, -0.8), veil, CATCHES),
            (scenes.plane("strip", 0.6), scenes.translation(-2, 0.5, -0.6), scenes.emitter(3.0), CATCHES),
            (ball, scenes.translation(0, 0, -0.3, 0.7), scenes.diffuse((0.6, 0.2, 0.2))),
            (ball, scenes.translation(1.5, 0.6, -0.3, 0.7), glass),
            (ball, scenes.translation(-1.3, -1, -0.6, 0.4), hole),
            (scenes.plane("sheet", 1.5), scenes.translation(-0.6, -1.4, 0.2), veil),
        ],
        view=scenes.camera(eye=(0.3, -5, 1.6), half_width=0.55, aspect=4 / 3),
        frame=Frame(
            16,
            12,
            passes=("Combined", CATCHER_PASS, CATCHER_SHADOWS, "CryptoObject00", "Mist", "Normal", "Depth", *LIGHT),
        ),
        lights=[scenes.sun(1.5, 0.1, scenes.look_at((1, -1, 3), (0, 0, 0))), scenes.area_light(3.0, 0.8)],
        world=(0.1, 0.15, 0.25),
    )


@pytest.mark.parametrize("transparent", [True, False])
def test_any_schedule_gives_the_same_film(session, transparent, examples, pytestconfig):
    scene = still_life()
    scene = dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, transparent=transparent))
    settings = RenderSettings(sample_count=3, bounce_max=4, roulette_bounce=2, clamp_indirect=3.0)
    comparer = FilmComparer(session, scene, settings, 16)
    shown = comparer.plain.passes[CATCHER_PASS]
    assert shown.std() > 0.05 and comparer.plain.passes["CryptoObject00"].any()
    fixed = {"schedule": "WAVEFRONT", **schedule_scenes.not_drawn("closed", pytestconfig.option.thorough)}
    for number in range(examples(24) // 2):
        found = comparer.compare_drawn(SeededDraws(number), fixed)
        assert not found.differs, (number, found.differs, comparer.simplest(found))


def test_mattes_and_mist_count_each_path_once(session):
    """Copies of paths record nothing."""
    film = session.render(still_life(), RenderSettings(sample_count=16))
    plain = still_life()
    bits = plain.instances.visibility & int(Visibility.ALL)
    plain = dataclasses.replace(plain, instances=dataclasses.replace(plain.instances, visibility=bits))
    ordinary = session.render(plain, RenderSettings(sample_count=16))
    for name in ("Mist", "CryptoObject00", "Diffuse Color", "Depth"):
        assert np.allclose(film.passes[name], ordinary.passes[name], atol=1e-4), name


def test_catchers_are_a_feature_where_a_pass_shows_them():
    scene = ground(frame(CATCHER_PASS))
    assert catchers(scene).tolist() == [True, False] and derive_features(scene, ONCE).catchers
    unshown = dataclasses.replace(scene, frame=frame())
    assert not derive_features(unshown, ONCE).catchers


def test_the_pass_of_a_scene_without_catchers_is_white(session):
    plain = scenes.scene([(scenes.plane(), scenes.IDENTITY, scenes.diffuse())], frame=frame(CATCHER_PASS), world=0.5)
    assert (session.render(plain, ONCE).passes[CATCHER_PASS] == 1).all()
