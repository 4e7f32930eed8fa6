"""How far aside bump mapping compares heights: a share of the pixel's width where the camera sees the surface."""

import numpy as np
import pytest

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.values.vector_math import VectorOperation
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Material
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.stages.surface.program import BUMP_STEP
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")

SIZE = 8
HALF_WIDTH = 0.05  # of the window one metre ahead: all pixels are about as far away
DISTANCE = 3.0


def stepped():
    """A material that emits the step along the first axis, and a normal that no height bends."""
    builder = ProgramBuilder()
    here, aside = (builder.value("position", shift) for shift in (0, 1))
    step = builder.value("vector_math", VectorOperation.SUBTRACT, aside, here, (0.0,) * 3, 0.0)[0]
    bent = builder.value("bump", 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, builder.value("normals")[0])
    builder.closure("emission", builder.value("vector_math", VectorOperation.ADD, step, bent, (0.0,) * 3, 0.0)[0])
    return Material("stepped", (), (ClosureKind.EMISSION,), builder.finish())


@pytest.mark.parametrize("clip_start", [0.01, 0.1, 1.5, 2.9])
def test_a_step_is_a_share_of_a_pixel_wherever_the_near_plane_is(clip_start):
    view = scenes.camera((0, 0, DISTANCE), half_width=HALF_WIDTH, up=(0.0, 1.0, 0.0), clip_start=clip_start)
    scene = scenes.scene([(scenes.plane(), np.eye(4)[:3], stepped())], view=view, frame=Frame(SIZE, SIZE))
    film = Session(DEVICE).render(scene, RenderSettings(device=DEVICE, sample_count=1, bounce_max=0))
    seen = film.passes["Combined"][..., :3]
    # along (1, -1, 0): what is negative is not emitted
    expected = BUMP_STEP * DISTANCE * 2 * HALF_WIDTH / SIZE / 2**0.5
    assert seen[..., 0] == pytest.approx(expected, rel=0.005)
    assert seen[..., 2] == pytest.approx(1.0)


def test_a_step_behind_a_near_mirror_is_about_that_of_the_way_from_the_camera():
    far, near = 20.0, 0.5  # from the camera to the mirror, and on to the surface
    half = 0.5**0.5
    mirror = np.array([[half, 0, half, 0], [0, 1, 0, 0], [-half, 0, half, 0]])  # faces (1, 0, 1)
    facing_it = np.array([[0, 0, -1, near], [0, 1, 0, 0], [1, 0, 0, 0]])  # faces (-1, 0, 0)
    view = scenes.camera((0, 0, far), half_width=HALF_WIDTH / 10, up=(0.0, 1.0, 0.0))
    objects = [
        (scenes.plane(size=0.5), mirror, scenes.material(Closure(ClosureKind.GLOSSY, (1.0,) * 3, roughness=0.0))),
        (scenes.plane(size=0.5), facing_it, stepped()),
    ]
    scene = scenes.scene(objects, view=view, frame=Frame(SIZE, SIZE))
    film = Session(DEVICE).render(scene, RenderSettings(device=DEVICE, sample_count=1, bounce_max=1))
    # along (0, -1, 1); the straight way from the camera stands for the bent one, which is longer by `near`
    expected = BUMP_STEP * (far + near) * 2 * (HALF_WIDTH / 10) / SIZE / 2**0.5
    assert film.passes["Combined"][..., 2] == pytest.approx(expected, rel=1.2 * near / far)
