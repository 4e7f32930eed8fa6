"""Glass without one kind of caustics reflects alone, or refracts alone, to diffuse surfaces.

A floor, which glows and is grey, lies under an interface of glass that is far wider than its distance. Light of the
floor that the glass reflects comes back to it, and that of the world comes through the glass: two sums in closed form.
"""

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.stability.transport.fresnel import reflectance
from tests.support.running.shares import thorough_but
from tests.support.scenes import IDENTITY, camera, material, plane, scene, translation

pytestmark = pytest.mark.usefixtures("general_kernels")
GREY = 0.5  # albedo of the floor
WORLD = 2.0  # radiance
IOR = 2.5


@pytest.fixture(scope="module")
def session():
    made = Session("cpu")
    yield made
    made.close()


def floor_under_glass():
    """The camera is between the floor and the glass, and sees the floor alone."""
    grey = material(Closure(ClosureKind.EMISSION, (1.0,) * 3), Closure(ClosureKind.DIFFUSE, (GREY,) * 3))
    glass = material(Closure(ClosureKind.GLASS, (1.0,) * 3, 0.0, ior=IOR))
    objects = [(plane("floor", 4e3), IDENTITY, grey), (plane("glass", 4e3), translation(0, 0, 1), glass)]
    view = camera(eye=(0.0, 0.0, 0.5), target=(0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0))
    return scene(objects, view=view, frame=Frame(16, 16), world=WORLD)


def mean(session, sample_count, **settings):
    """Mean of the picture, and its error."""
    chosen = RenderSettings(sample_count=sample_count, bounce_max=64, **settings)
    picture = session.render(floor_under_glass(), chosen).passes["Combined"][..., 0].astype(np.float64)
    return picture.mean(), picture.std() / np.sqrt(picture.size)


def reflected_share() -> float:
    """Share of diffuse light from below that the glass reflects; its lower side is its inside.

    Beyond the critical angle all is reflected. Below it, the integral is over the cosine behind the glass, in which it
    is smooth.
    """
    nodes, weights = np.polynomial.legendre.leggauss(64)
    behind = (nodes + 1) / 2
    before = np.sqrt(1 - (1 - behind**2) / IOR**2)
    beyond = 1 - 1 / IOR**2
    return float(beyond + np.sum(weights * behind / IOR**2 * reflectance(before, 1 / IOR)))


@pytest.mark.parametrize("nee", thorough_but(["ON"], ["OFF", "ON"]))
def test_without_refractive_caustics_glass_reflects(session, nee, examples):
    found, error = mean(session, examples(256), caustics_refractive="OFF", nee=nee)
    assert abs(found - 1 / (1 - GREY * reflected_share())) < 5 * error + 1e-3


@pytest.mark.parametrize("nee", thorough_but(["OFF"], ["OFF", "ON"]))
def test_without_reflective_caustics_glass_refracts(session, nee, examples):
    found, error = mean(session, examples(256), caustics_reflective="OFF", nee=nee)
    assert abs(found - (1 + GREY * (1 - reflected_share()) * WORLD)) < 5 * error + 1e-3


def test_with_both_and_with_neither(session, examples):
    share = reflected_share()
    both = (1 + GREY * (1 - share) * WORLD) / (1 - GREY * share)
    found, error = mean(session, examples(256))
    assert abs(found - both) < 5 * error + 1e-3
    found, error = mean(session, examples(256), caustics_reflective="OFF", caustics_refractive="OFF")
    assert abs(found - 1.0) < 5 * error + 1e-6
