"""Transparent films that show through glass."""

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame
from raybatch_addon.core.settings.settings import RenderSettings
from tests.renders.volumes.test_volumes import filled, medium
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

THRESHOLD = 0.1
CLEAR = ClosureKind.REFRACTION
WHITE = (1.0, 1.0, 1.0)
# Far off: tests have kernels of these closures in common
KINDS = (ClosureKind.DIFFUSE, ClosureKind.GLASS, ClosureKind.REFRACTION, ClosureKind.HOLDOUT)
FAR_OFF = [
    (scenes.plane(kind.name, 0.01), scenes.translation(1e3, 0, 0), scenes.material(Closure(kind, WHITE, ior=1.5)))
    for kind in KINDS
]


def pane(kind: ClosureKind = CLEAR, roughness: float = 0.0, ior: float = 1.0, z: float = 1.0, weight=WHITE):
    """A pane that fills the picture."""
    closure = Closure(kind, weight, roughness=roughness, ior=ior)
    return scenes.plane(size=8.0), scenes.translation(0, 0, z), scenes.material(closure)


def seen(session, *objects, threshold: float | None = THRESHOLD, samples: int = 64, **schedule) -> np.ndarray:
    """Mean colour and alpha, shape [4], of `objects` from above under a white world, on a transparent film."""
    frame = Frame(8, 8, transparent=True, glass_roughness=threshold)
    view = scenes.camera(eye=(0.0, 0.0, 3.0), half_width=0.05, up=(0.0, 1.0, 0.0))
    scene = scenes.scene([*objects, *FAR_OFF], frame=frame, view=view, world=1.0)
    film = session.render(scene, RenderSettings(sample_count=samples, bounce_max=4, **schedule))
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"].mean((0, 1))


def test_a_film_shows_through_glass_that_is_smooth_enough(session):
    assert np.array_equal(seen(session, pane()), [0, 0, 0, 0])
    assert np.array_equal(seen(session, pane(), threshold=None), [1, 1, 1, 1])
    # the color that the glass takes is alpha, as that of other transparent things is
    assert seen(session, pane(weight=(0.25, 0.5, 0.75))) == pytest.approx([0, 0, 0, 0.5])


def test_glass_that_is_rougher_shows_the_world(session):
    smooth, rough = (seen(session, pane(roughness=roughness, ior=1.3))[3] for roughness in (0.09, 0.11))
    assert smooth < 0.05 and rough > 0.95


def test_reflections_stay(session):
    reflected = (0.5 / 2.5) ** 2
    found = seen(session, pane(ClosureKind.GLASS, ior=1.5), samples=1024)
    assert found == pytest.approx([reflected] * 4, rel=0.1)
    assert found[3] == pytest.approx(found[0], rel=1e-3)


def test_what_is_behind_glass_covers_the_film(session):
    floor = scenes.plane(size=8.0), scenes.IDENTITY, scenes.diffuse(0.5)
    assert seen(session, pane(), pane(z=0.5), floor)[3] == 1
    assert seen(session, pane(), pane(z=0.5))[3] == 0


def test_holdouts_behind_glass_are_holes(session):
    hole = scenes.plane(size=8.0), scenes.IDENTITY, scenes.material(Closure(ClosureKind.HOLDOUT, WHITE))
    assert seen(session, pane(), hole)[3] == pytest.approx(0)
    assert seen(session, pane(), hole, threshold=None)[3] == 1


def test_light_that_volumes_behind_glass_scatter_is_no_background(session):
    smoke = scenes.box(), scenes.IDENTITY, filled(medium(scattering=0.5))
    bare = seen(session, smoke, samples=256)[3]
    assert 0.2 < bare < 0.95
    assert seen(session, pane(z=2.0), smoke, samples=256)[3] == pytest.approx(bare, rel=0.03)


def test_no_schedule_changes_the_film(session):
    floor = scenes.plane(size=0.03), scenes.IDENTITY, scenes.diffuse(0.5)
    objects = pane(ClosureKind.GLASS, 0.05, 1.5), pane(roughness=0.08, ior=1.2, z=0.5), floor
    first = seen(session, *objects)
    assert 0 < first[3] < 1
    for schedule in ({"batching": "ON", "ray_count": 64}, {"sample_order": "FRAME_FIRST", "tile_size": 16}):
        assert np.array_equal(seen(session, *objects, **schedule), first)
