"""Limits of bounces by kind, and light without caustics, inside a box that glows and reflects in two ways.

Every point of the box emits 1, and its closures reflect a share each: the light of a path is that share to the power of
its length, and the picture is the sum over all paths that may be, counted here one by one.
"""

import itertools

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support.scenes import IDENTITY, box, camera, material, scene

pytestmark = pytest.mark.usefixtures("general_kernels")
SHARE = 0.4  # of either closure
BOUNCES = 3


@pytest.fixture(scope="module")
def session():
    made = Session("cpu")
    yield made
    made.close()


def inside():
    """The box from within."""
    weight = (SHARE,) * 3
    surface = material(
        Closure(ClosureKind.EMISSION, (1.0, 1.0, 1.0)),
        Closure(ClosureKind.DIFFUSE, weight),
        Closure(ClosureKind.GLOSSY, weight, 0.0),
    )
    return scene([(box(), IDENTITY, surface)], view=camera(eye=(0.1, -0.3, 0.2), target=(0, 1, 0)), frame=Frame(16, 16))


def mean(session, **settings):
    """Mean of the picture, and its error."""
    chosen = RenderSettings(sample_count=256, nee="OFF", bounce_max=BOUNCES, roulette_bounce=100, **settings)
    film = session.render(inside(), chosen)
    picture = film.passes["Combined"][..., 0].astype(np.float64)
    return picture.mean(), picture.std() / np.sqrt(picture.size), film


def expected(diffuse: int, glossy: int, caustics: bool = True) -> float:
    """The sum over all paths: words of the letters D and G, of which each next one may still be."""
    total = 1.0
    for length in range(1, BOUNCES + 2):
        for word in itertools.product("DG", repeat=length):
            before = word[:-1]
            spent = before.count("D") > diffuse or before.count("G") > glossy
            if not spent and (caustics or ("D", "G") not in itertools.pairwise(word)):
                total += SHARE**length
    return total


@pytest.mark.parametrize(("diffuse", "glossy"), [(0, 1024), (1024, 0), (1, 2), (1024, 1024)])
def test_a_kind_of_bounces_ends_paths(session, diffuse, glossy):
    found, error, _ = mean(session, diffuse_bounce_max=diffuse, glossy_bounce_max=glossy)
    assert abs(found - expected(diffuse, glossy)) < 5 * error + 1e-6


def test_without_caustics_nothing_is_reflected_sharply_to_a_diffuse_surface(session):
    found, error, _ = mean(session, caustics_reflective="OFF", diffuse_bounce_max=2)
    assert abs(found - expected(2, 1024, caustics=False)) < 5 * error + 1e-6
    assert found < expected(2, 1024) - 20 * error


def test_schedules_give_the_same_film(session):
    settings = dict(caustics_reflective="OFF", diffuse_bounce_max=2, filter_glossy=2.0)
    films = [
        mean(session, **settings, **schedule)[2].passes["Combined"]
        for schedule in (
            {},
            {"batching": "ON", "treelet_size": 8, "ray_count": 512},
            {"tile_size": 8, "thread_count": 1},
        )
    ]
    assert all(np.array_equal(films[0], film) for film in films)
