"""Surfaces that send rays on elsewhere: closed forms, and the same film under any schedule."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Closure, Frame, Material, Volume
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.tier import why_not_general
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")

ALBEDO, HERE, THERE = 0.5, 3.0, 8.0
PLACE = (100.0, 0.0, 0.0)


def portal(share=1.0, position=PLACE, direction=(0.0, 0.0, 0.0), *others):
    closure = Closure(K.RAY_PORTAL, (share,) * 3, edge=position or (0.0, 0.0, 0.0), tangent=direction)
    if position is not None:
        closure = Closure(K.RAY_PORTAL, (share,) * 3, edge=position, tangent=direction, distribution=1)
    return scenes.material(closure, *others, name="portal")


def transparent(share):
    return Closure(K.TRANSPARENT, (share,) * 3)


def dome(shell: Material, frame=Frame(6, 6)):
    """A floor under a dome of `shell`, with light around it; far off a place with more light around it."""
    ball = scenes.sphere(segments=16, rings=8)
    return scenes.scene(
        [
            (scenes.plane(size=1.0), scenes.IDENTITY, scenes.diffuse(ALBEDO)),
            (ball, scenes.translation(0, 0, 0, 4.0), shell),
            (scenes.sphere("outside", 16, 8, 6.0), scenes.IDENTITY, scenes.emitter(HERE)),
            (scenes.sphere("away", 16, 8, 2.0), scenes.translation(*PLACE), scenes.emitter(THERE)),
        ],
        view=scenes.camera(eye=(0, 0, 1), half_width=0.1, up=(0.0, 1.0, 0.0)),
        frame=frame,
    )


def render(session, scene, **settings):
    film = session.render(scene, RenderSettings(**dict(sample_count=256, bounce_max=2) | settings))
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"][..., :3].astype(float)


@pytest.mark.parametrize("nee", ["ON", "OFF"])
@pytest.mark.parametrize(
    ("shell", "light"),
    [
        (portal(), THERE),
        (portal(0.25), 0.25 * THERE),
        (portal(1.0, None), HERE),
        (portal(1.0, None, (0.0, 0.6, 0.8)), HERE),
        (portal(0.4, PLACE, (0.0, 0.0, 0.0), transparent(0.6)), 0.6 * HERE + 0.4 * THERE),
    ],
    ids=["elsewhere", "tinted", "straight on", "turned", "mixed"],
)
def test_light_behind_a_portal_counts_once(session, shell, light, nee):
    seen = render(session, dome(shell), nee=nee)
    assert seen.mean() == pytest.approx(ALBEDO * light, rel=0.02)


@pytest.mark.parametrize("gates", [0, 1, 2])
def test_programs_are_given_how_many_portals_a_path_has_passed(session, gates):
    """Up to three, on the way to a mirror and back; it and a veil are not among them."""
    builder = ProgramBuilder()
    reported = builder.value("portal_depth")
    builder.closure("emission", builder.value("combine_xyz", reported, reported, reported))
    wall = replace(scenes.emitter(), closures=(), program=builder.finish(), kinds=(K.EMISSION,))
    between = [
        (scenes.plane(f"gate {i}", 2.0), scenes.translation(0, 0, 1 + 0.1 * i), portal(1.0, None)) for i in range(gates)
    ]
    veil = scenes.plane("veil", 2.0), scenes.translation(0, 0, 0.5), scenes.material(transparent(1.0))
    mirror = scenes.plane("mirror", 2.0), scenes.IDENTITY, scenes.material(Closure(K.GLOSSY, (1.0,) * 3))
    scene = scenes.scene(
        [*between, veil, mirror, (scenes.plane("wall", 40.0), scenes.translation(0, 0, 3), wall)],
        view=scenes.camera(eye=(0, 0, 2.5), target=(0, 0, 0), half_width=0.01, up=(0.0, 1.0, 0.0)),
        frame=Frame(4, 4),
    )
    assert (render(session, scene, sample_count=4, bounce_max=3) == min(2 * gates, 3)).all()


def test_a_portal_hides_lamps(session):
    """A shadow ray does not know where a portal would send it."""
    scene = scenes.scene(
        [
            (scenes.plane(size=1.0), scenes.IDENTITY, scenes.diffuse(ALBEDO)),
            (scenes.plane("gate", 4.0), scenes.translation(0, 0, 2), portal(1.0, None)),
        ],
        view=scenes.camera(eye=(0, 0, 1), half_width=0.1, up=(0.0, 1.0, 0.0)),
        frame=Frame(4, 4),
        lights=[scenes.sun(3.0, 0.0, scenes.look_at((0, 0.1, 5), (0, 0, 0)))],
    )
    assert not render(session, scene, sample_count=4).any()


def test_portals_count_as_transparent_surfaces(session):
    """Two portals before each other: with one passage light behind the second is not found."""
    gates = [(scenes.plane(f"gate {z}"), scenes.translation(0, 0, z), portal(1.0, None)) for z in (-1, -2)]
    scene = scenes.scene(
        gates, view=scenes.camera(eye=(0, 0, 1), half_width=0.1, up=(0.0, 1.0, 0.0)), frame=Frame(4, 4), world=1.0
    )
    assert render(session, scene, transparent_bounce_max=2).min() == 1.0
    assert render(session, scene, transparent_bounce_max=1).max() == 0.0


@pytest.mark.parametrize(
    "change",
    [
        {"batching": "ON", "treelet_size": 16},
        {"batching": "ON", "ray_count": 100, "queue_size": 8},
        {"tile_size": 5, "thread_count": 2},
        {"batching": "ON", "treelet_size": 16, "geometry_budget": 20_000, "geometry_store": "HOST"},
        {"ray_sort": "ON", "sample_order": "FRAME_FIRST"},
    ],
    ids=str,
)
def test_any_schedule_gives_the_same_film(session, change):
    scene = dome(
        portal(0.4, PLACE, (0.0, 0.0, 0.0), transparent(0.3), Closure(K.DIFFUSE, (0.3, 0.2, 0.1))), Frame(20, 14)
    )
    few = dict(sample_count=3, bounce_max=4, transparent_bounce_max=5)
    np.testing.assert_array_equal(
        render(session, scene, **few, **change), render(session, scene, **few, batching="OFF")
    )


def test_scenes_without_portals_have_no_code_for_them():
    settings = RenderSettings()
    without, with_one = (derive_features(dome(each), settings) for each in (scenes.diffuse(), portal()))
    assert K.RAY_PORTAL not in without.closures and not without.transparency
    assert with_one.transparency and "Ray Portal" in why_not_general(with_one, SimpleNamespace(is_cuda=True))


@pytest.mark.parametrize("where", ["world", "object"])
def test_portals_beside_volumes_of_objects_are_reported(session, where):
    """Rays do not find out which volumes are around the place where they come out; the world's is everywhere."""
    scene = dome(portal(), Frame(2, 2))
    mist = Volume((Closure(K.VOLUME_ABSORPTION, (1e-3,) * 3),))
    if where == "world":
        scene = replace(scene, world=replace(scene.world, volume=mist))
    else:
        scene = replace(scene, materials=(*scene.materials, Material("mist", volume=mist)))
    film = session.render(scene, RenderSettings(sample_count=1))
    reported = [text for text in film.statistics["warnings"] if text.startswith("Ray Portal: ")]
    assert len(reported) == (where == "object")
