"""Shadow rays through surfaces whose programs let light pass: they run a part of the program, and rays end at the first
surface where no program has such a part.
"""

import numpy as np
import pytest

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Material
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.integrator import TileIntegrator
from raybatch_addon.core.wavefront.stages.work import ShadingStage
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")
KINDS = (ClosureKind.DIFFUSE, ClosureKind.TRANSPARENT)
SETTINGS = RenderSettings(bounce_max=3, sample_count=4)


def of_program(name: str, passes: bool) -> Material:
    """A grey surface that lets blue light pass where it `passes`: the square of its normal, which is upright."""
    builder = ProgramBuilder()
    normal = builder.value("normals")[0]
    if passes:
        builder.closure("transparent", builder.value("multiply_colors", normal, normal))
    builder.closure("diffuse", (0.5, 0.5, 0.5), (0.0, 0.0, 0.0))
    return Material(name, (), KINDS, builder.finish())


def below_a_veil(veil: Material, floor: Material):
    view = scenes.camera(eye=(0.0, -3.0, 0.3), target=(0.0, 0.0, -0.7), half_width=0.5)
    objects = [
        (scenes.plane(size=20.0), scenes.translation(0, 0, -1), floor),
        (scenes.plane("veil", 2.0), scenes.translation(0, 0, 0), veil),
    ]
    return scenes.scene(objects, view=view, frame=Frame(24, 20), lights=[scenes.sun(1.0, 0.1)])


def film_of(session, scene):
    film = session.render(scene, SETTINGS)
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"]


def test_programs_let_shadow_rays_through_as_closures_do(session):
    plain = scenes.material(
        Closure(ClosureKind.TRANSPARENT, (0.0, 0.0, 1.0)), Closure(ClosureKind.DIFFUSE, (0.5, 0.5, 0.5)), name="veil"
    )
    grey = scenes.diffuse(0.5)
    expected = film_of(session, below_a_veil(plain, grey))
    found = film_of(session, below_a_veil(of_program("veil", True), of_program("floor", False)))
    np.testing.assert_array_equal(found, expected)
    dark = film_of(session, below_a_veil(of_program("veil", False), grey))
    assert expected[..., 2].mean() > 1.2 * dark[..., 2].mean()


@pytest.mark.parametrize("passes", [False, True])
def test_shadow_rays_end_at_the_first_surface_where_none_lets_light_through(session, monkeypatch, passes):
    """A material that could let light through, by its kinds, does not make others slower while it is opaque."""
    launched = set()
    launch = TileIntegrator._launch_stage
    monkeypatch.setattr(
        TileIntegrator, "_launch_stage", lambda self, stage, *rest: (launched.add(stage), launch(self, stage, *rest))
    )
    film_of(session, below_a_veil(of_program("veil", passes), scenes.diffuse(0.5)))
    assert (ShadingStage.CONNECT_TRANSPARENT in launched) == passes
    assert (ShadingStage.CONNECT in launched) == (not passes)
