"""What is counted of paths in volumes: how often programs exceed the bounds that were found, and where light ends."""

import dataclasses
import math

import numpy as np
import pytest

from raybatch_addon.core.measure.volumes import SHARE_UNITS, VolumeCounts
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.description import Volume
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.wavefront.volumes import bounds, table
from tests.renders.volumes.test_volumes import color, in_box, medium, varying
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")


def everywhere(density: float) -> Volume:
    """A volume that absorbs as much everywhere, by a program that asks where it is."""
    builder = ProgramBuilder()
    x = builder.value("separate_xyz", builder.value("position", 0))[0]
    value = builder.value("math", int(MathOperation.MULTIPLY_ADD), False, x, 0.0, density)
    builder.closure("volume_absorption", builder.value("splat", value))
    return Volume(program=builder.finish())


def rendered(session, volume: Volume, **changes):
    return session.render(in_box(volume), RenderSettings(**(dict(sample_count=64, bounce_max=0) | changes)))


@pytest.mark.parametrize(("share", "density"), [(1.0, 1.0), (0.25, 1.2)])  # a session keeps bounds that are alike
def test_density_above_its_bound_is_counted_and_said(session, monkeypatch, share, density):
    """With bounds of a quarter of the density three quarters are missing, and the picture is that of the rest."""
    monkeypatch.setattr(bounds, "_MARGIN", share)
    film = rendered(session, everywhere(density))
    counts = film.statistics["volumes"]
    assert counts["density_missing"] == pytest.approx(1.0 - share, abs=1e-4)
    assert counts["exceeded"] == (counts["collisions"] if share < 1 else 0)
    assert any("75 % of the density" in text for text in film.statistics["warnings"]) == (share < 1)
    np.testing.assert_allclose(color(film).mean(), math.exp(-2.0 * share * density), rtol=0.1)
    # a flight ends 2 * share * density times in 2 m, in the mean, or once where that ends the path
    assert 0 < counts["collisions"] < 1.1 * 2.0 * share * density * 64 * 64


def test_bounds_of_smooth_density_are_not_exceeded(session):
    made = in_box(varying(absorption=0.5, scattering=1.0), sun=1.0, lamp=1.0)
    film = session.render(made, RenderSettings(sample_count=64, bounce_max=8))
    counts, rays = film.statistics["volumes"], film.statistics["rays"]
    assert counts["exceeded"] == counts["shadow_rays_cut"] == counts["paths_cut"] == 0 == counts["density_missing"]
    assert rays["shadow"] / 2 < counts["shadow_rays"] and rays["shadow"] > 0
    assert not any("volumes:" in text for text in film.statistics["warnings"])


def test_counts_are_of_each_render_alone(session):
    first, second = (rendered(session, everywhere(1.0)).statistics["volumes"] for _ in range(2))
    assert first == second


def test_what_does_not_vary_has_no_collisions_and_no_volumes_no_counts(session):
    assert set(rendered(session, medium(1.0)).statistics["volumes"].values()) == {0}
    plain = scenes.scene([(scenes.box(), scenes.IDENTITY, scenes.diffuse(0.8))])
    assert session.render(plain, RenderSettings(sample_count=1)).statistics["volumes"] is None


def test_columns_are_in_the_order_of_their_names():
    names = [field.name.upper() for field in dataclasses.fields(VolumeCounts)]
    assert [getattr(table, name) for name in names] == list(range(table.COUNTS))


@pytest.mark.parametrize(
    ("what", "few", "many"),
    [
        ("% of the density", dict(density=1000, density_lost=5), dict(density=1000, density_lost=20)),
        ("shadow rays", dict(shadow_rays=10_000, shadow_rays_cut=10), dict(shadow_rays=10_000, shadow_rays_cut=11)),
        ("paths ended", dict(paths_cut=10), dict(paths_cut=11)),
    ],
)
def test_warnings_are_of_shares_that_matter(what, few, many):
    nothing = dict.fromkeys((field.name for field in dataclasses.fields(VolumeCounts)), 0)
    assert VolumeCounts(**{**nothing, **few}).warnings(10_000) == []
    (said,) = VolumeCounts(**{**nothing, **many}).warnings(10_000)
    assert what in said and said.startswith("volumes: ")


def test_shares_add_up_without_rounding():
    counts = VolumeCounts(4, 1, 3 * SHARE_UNITS, SHARE_UNITS, 0, 0, 0)
    assert counts.missing == 0.25
