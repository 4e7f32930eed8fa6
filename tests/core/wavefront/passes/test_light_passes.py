"""Light is divided among passes by how often it was scattered and by what at first; together they are the picture."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame
from raybatch_addon.core.scene.passes import COLOR_PASSES, COMPONENTS, DIRECT_PASSES, INDIRECT_PASSES, SEEN_PASSES
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes, schedule_scenes

LIGHT = ("Combined", *DIRECT_PASSES, *INDIRECT_PASSES, *COLOR_PASSES, *SEEN_PASSES)
SETTINGS = RenderSettings(sample_count=8, bounce_max=5)
pytestmark = pytest.mark.usefixtures("general_kernels")


def composed(passes):
    """The picture that the passes of light give together."""
    total = passes["Emission"] + passes["Environment"]
    for component in COMPONENTS:
        light = passes[f"{component} Direct"] + passes[f"{component} Indirect"]
        total = total + light * passes[f"{component} Color"]
    return total


def rendered(session, scene, passes=LIGHT, **changes):
    scene = dataclasses.replace(scene, frame=dataclasses.replace(scene.frame, passes=passes))
    return session.render(scene, SETTINGS.replace(**changes)).passes


@pytest.mark.parametrize("changes", [{}, dict(nee="OFF"), dict(clamp_indirect=0.5)], ids=str)
@pytest.mark.parametrize("name", schedule_scenes.SCENES)
def test_the_passes_together_are_the_picture(session, name, changes):
    passes = rendered(session, schedule_scenes.SCENES[name](), **changes)
    # a mean of each is rounded once, and their products and sums a few times
    assert composed(passes) == pytest.approx(passes["Combined"][..., :3], rel=2e-6, abs=1e-6)
    assert passes["Combined"][..., :3].any()


def looking_down(surface, **more):
    """A plane that fills the picture, seen from straight above."""
    view = scenes.camera(eye=(0, 0, 3), up=(0, 1, 0), half_width=0.2)
    return scenes.scene([(scenes.plane(size=8), scenes.IDENTITY, surface)], view=view, frame=Frame(4, 4), **more)


def test_a_sun_on_a_matte_plane_is_direct_and_diffuse(session):
    passes = rendered(session, looking_down(scenes.diffuse((0.5, 0.4, 0.2)), lights=[scenes.sun(2.0)]))
    assert passes["Diffuse Direct"] == pytest.approx(2 / np.pi, rel=1e-5)
    assert passes["Diffuse Color"].reshape(-1, 3)[5] == pytest.approx((0.5, 0.4, 0.2), rel=1e-6)
    for name in set(LIGHT) - {"Combined", "Diffuse Direct", "Diffuse Color"}:
        assert not passes[name].any(), name


@pytest.mark.parametrize(
    ("kind", "component"),
    [
        (ClosureKind.DIFFUSE, "Diffuse"),
        (ClosureKind.GLOSSY, "Glossy"),
        (ClosureKind.REFRACTION, "Transmission"),
        (ClosureKind.TRANSLUCENT, "Diffuse"),
    ],
)
def test_a_white_world_is_seen_through_the_component_of_a_closure(session, kind, component):
    """Light that was scattered once is direct; divided by its colour it is that of the world."""
    closure = Closure(kind, (0.8, 0.6, 0.4), ior=1.0)
    passes = rendered(session, looking_down(scenes.material(closure), world=1.0), sample_count=4)
    lit = passes[f"{component} Direct"]
    assert lit == pytest.approx(1, rel=1e-5)
    assert passes[f"{component} Color"].reshape(-1, 3)[0] == pytest.approx((0.8, 0.6, 0.4), rel=1e-6)
    for other in set(COMPONENTS) - {component}:
        assert not passes[f"{other} Color"].any() and not passes[f"{other} Direct"].any(), other
    assert not passes["Environment"].any()


def test_light_that_was_not_scattered_is_emission_or_environment(session):
    passes = rendered(session, looking_down(scenes.emitter(3.0), world=0.5))
    assert passes["Emission"] == pytest.approx(3, rel=1e-6) and not passes["Environment"].any()
    veil = scenes.material(Closure(ClosureKind.TRANSPARENT, (1.0, 0.5, 0.25)))
    passes = rendered(session, looking_down(veil, world=0.5))
    assert passes["Environment"].reshape(-1, 3)[0] == pytest.approx((0.5, 0.25, 0.125), rel=1e-6)


def test_a_transparent_film_has_the_world_in_its_pass(session):
    scene = scenes.scene([], frame=Frame(4, 4, transparent=True), world=0.5)
    passes = rendered(session, scene)
    assert not passes["Combined"].any() and np.all(passes["Environment"] == 0.5)


def test_a_lamp_that_casts_no_shadow_is_direct_light(session):
    lamp = dataclasses.replace(scenes.sun(2.0), casts_shadow=False)
    scene = looking_down(scenes.diffuse(0.5), lights=[lamp])
    passes = rendered(session, scene)
    assert passes["Diffuse Direct"] == pytest.approx(2 / np.pi, rel=1e-5)


def test_light_below_a_surface_is_diffuse(session):
    medium = Closure(ClosureKind.SUBSURFACE, (0.8,) * 3, ior=1.4, color=(0.9,) * 3, edge=(20.0,) * 3)
    ball = (scenes.sphere(segments=16, rings=8), scenes.IDENTITY, scenes.material(medium))
    passes = rendered(session, scenes.scene([ball], frame=Frame(8, 8), world=1.0))
    assert passes["Diffuse Direct"].max() > 0.3 and not passes["Glossy Direct"].any()
    assert composed(passes) == pytest.approx(passes["Combined"][..., :3], rel=2e-6, abs=1e-6)


def test_one_pass_alone_is_that_of_all(session):
    scene = scenes.mixed()
    whole = rendered(session, scene)
    for name in ("Diffuse Direct", "Glossy Indirect", "Emission", "Transmission Color"):
        alone = rendered(session, scene, ("Combined", name))
        assert set(alone) == {"Combined", name} and np.array_equal(alone[name], whole[name]), name
        assert np.array_equal(alone["Combined"], whole["Combined"])


def test_passes_do_not_change_the_picture(session):
    scene = scenes.mixed()
    assert np.array_equal(rendered(session, scene)["Combined"], rendered(session, scene, ("Combined",))["Combined"])
