"""Surfaces that light passes, and shadow rays do not, where their material says so.

A floor lies under a veil of half transparency, and the sun stands above both.
"""

import dataclasses
import math

import pytest

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Material, Volume
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")
HALF = (0.5, 0.5, 0.5)
SUN = 4.0  # irradiance


def even_veil() -> Material:
    return scenes.material(Closure(ClosureKind.TRANSPARENT, HALF))


def veil_of_a_program() -> Material:
    builder = ProgramBuilder()
    builder.closure("transparent", HALF)
    return Material("veil", (), (ClosureKind.TRANSPARENT,), builder.finish())


def half_seen(veil: Material, *, fog: bool = False, apart: bool = False):
    """A white floor under `veil`. `fog`: a volume that absorbs nothing is far away; `apart`: a veil that light passes
    too lies above the other.
    """
    objects = [
        (scenes.plane("floor", 50.0), scenes.IDENTITY, scenes.diffuse(1.0)),
        (scenes.plane("veil", 50.0), scenes.translation(0, 0, 1), veil),
    ]
    if apart:
        objects.append((scenes.plane("second", 50.0), scenes.translation(0, 0, 2), even_veil()))
    if fog:
        filled = dataclasses.replace(even_veil(), volume=Volume((Closure(ClosureKind.VOLUME_ABSORPTION, (0.0,) * 3),)))
        objects.append((scenes.box("fog"), scenes.translation(0, 0, -9), filled))
    view = scenes.camera(eye=(0.0, 0.0, 3.0), target=(0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), half_width=0.1)
    return scenes.scene(objects, view=view, frame=Frame(8, 8), lights=[scenes.sun(SUN)])


def rendered(session, scene, **more):
    film = session.render(scene, RenderSettings(sample_count=4, bounce_max=0, **more))
    assert film.statistics["invalid_samples"] == 0
    return film


def mean(session, scene) -> float:
    return float(rendered(session, scene).passes["Combined"][..., :3].mean())


@pytest.mark.parametrize("fog", [False, True], ids=["", "beside a volume"])
@pytest.mark.parametrize("made", [even_veil, veil_of_a_program])
def test_a_veil_blocks_shadow_rays_alone(session, made, fog):
    clear, opaque = made(), dataclasses.replace(made(), shadow_opaque=True)
    down_and_up = 0.5 * 0.5 * SUN / math.pi
    assert mean(session, half_seen(clear, fog=fog)) == pytest.approx(down_and_up, rel=1e-4)
    assert mean(session, half_seen(opaque, fog=fog)) == 0
    assert mean(session, half_seen(opaque, fog=fog, apart=True)) == 0


def test_shadow_rays_end_at_any_hit_where_no_material_lets_them_pass(session):
    for is_opaque in (False, True):
        veil = dataclasses.replace(even_veil(), shadow_opaque=is_opaque)
        rays = rendered(session, half_seen(veil), counters="ON").statistics["counters"]["rays"]
        assert bool(sum(rays["transparent_shadow"])) != is_opaque and bool(sum(rays["occlusion"])) == is_opaque
