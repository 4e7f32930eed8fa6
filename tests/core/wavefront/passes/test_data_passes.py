"""Passes of what is seen: distances, coordinates, numbers, values of materials."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import CameraKind, Closure, ClosureKind, Frame, Volume
from raybatch_addon.core.scene.passes import AOV_COLOR, AOV_VALUE, SUMMED_PASSES, VECTOR
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

SETTINGS = RenderSettings(sample_count=4, bounce_max=2)
pytestmark = pytest.mark.usefixtures("general_kernels")


def looking_down(*objects, passes, **frame):
    """What lies on the planes z = 0, -1, -2, seen from z = 3 in parallel."""
    view = dataclasses.replace(scenes.camera(eye=(0, 0, 3), up=(0, 1, 0), half_width=1.0), kind=CameraKind.ORTHOGRAPHIC)
    placed = [(scenes.plane(size=8), scenes.translation(0, 0, -i), surface) for i, surface in enumerate(objects)]
    return scenes.scene(placed, view=view, frame=Frame(8, 8, passes=("Combined", *passes), **frame), world=0.3)


def veil(share):
    return scenes.material(
        Closure(ClosureKind.TRANSPARENT, (share,) * 3), Closure(ClosureKind.DIFFUSE, (1 - share,) * 3), name="veil"
    )


@pytest.mark.parametrize(("falloff", "mist"), [(1.0, 0.25), (2.0, 0.0625), (0.5, 0.5)])
def test_mist_grows_with_the_distance(session, falloff, mist):
    scene = looking_down(scenes.diffuse(), passes=("Mist",), mist=(2.0, 4.0, falloff))
    assert session.render(scene, SETTINGS).passes["Mist"] == pytest.approx(mist, abs=1e-6)


def test_nothing_lies_in_the_densest_mist(session):
    scene = scenes.scene([], frame=Frame(4, 4, passes=("Combined", "Mist")))
    assert np.all(session.render(scene, SETTINGS).passes["Mist"] == 1)


@pytest.mark.parametrize("name", SUMMED_PASSES)
def test_each_pass_can_be_had_alone(session, name):
    """Of a scene without surfaces, too."""
    empty = scenes.scene([], frame=Frame(4, 4, passes=("Combined", name)), world=0.3)
    film = session.render(empty, SETTINGS)
    assert film.passes["Combined"][..., :3] == pytest.approx(0.3, abs=1e-6)
    values = film.passes[name]
    assert np.isfinite(values).all() and np.ptp(values, axis=(0, 1)).max() < 1e-6
    seen = session.render(looking_down(scenes.diffuse(), passes=(name,)), SETTINGS)
    assert np.isfinite(seen.passes[name]).all()


def test_mist_counts_what_is_seen_through_a_veil(session):
    """Half of the view ends in mist of 0.25, the other half in mist of 0.5: in the mean of samples."""
    scene = looking_down(veil(0.5), scenes.diffuse(), passes=("Mist",), mist=(2.0, 4.0, 1.0))
    found = session.render(scene, SETTINGS.replace(sample_count=256)).passes["Mist"]
    assert found.mean() == pytest.approx(1 - (0.75 + 0.5) / 2, abs=3 * float(found.std()) / 8)


def test_uv_is_the_map_and_0_without_one(session):
    scene = looking_down(scenes.diffuse(), passes=("UV", "Position"))
    assert not session.render(scene, SETTINGS).passes["UV"].any()
    mesh = scene.meshes[0]
    corners = (mesh.positions[mesh.triangles][..., :2] / 8 + 0.5).astype(np.float32)
    mapped = dataclasses.replace(scene, meshes=(dataclasses.replace(mesh, corner_uvs=corners),))
    passes = session.render(mapped, SETTINGS.replace(sample_count=1)).passes
    assert passes["UV"][..., :2] == pytest.approx(passes["Position"][..., :2] / 8 + 0.5, abs=1e-5)
    assert np.all(passes["UV"][..., 2] == 1)


def numbered(scene):
    """`scene` with objects and materials numbered from 1."""
    info = np.zeros((len(scene.instances), 6), np.float32)
    info[:, 4] = np.arange(len(info)) + 1
    materials = tuple(dataclasses.replace(each, index=10 * (i + 1)) for i, each in enumerate(scene.materials))
    instances = dataclasses.replace(scene.instances, info=info)
    return dataclasses.replace(scene, instances=instances, materials=materials)


@pytest.mark.parametrize(("share", "seen"), [(0.4, 1), (0.6, 2)])
def test_data_are_those_of_the_first_surface_that_is_not_transparent(session, share, seen):
    names = ("Object Index", "Material Index", "Depth", "Position")
    # a threshold of alpha of a half; without black closures every path passes what it may
    surface = scenes.material(Closure(ClosureKind.TRANSPARENT, (share,) * 3))
    scene = numbered(looking_down(surface, scenes.diffuse(), passes=names))
    passes = session.render(scene, SETTINGS).passes
    expected = {"Object Index": seen, "Material Index": 10 * seen, "Depth": 2 + seen}
    for name, value in expected.items():
        assert np.all(passes[name] == value), name
    assert np.all(passes["Position"][..., 2] == 1 - seen)


def test_indices_are_0_where_nothing_is_seen(session):
    scene = numbered(looking_down(veil(0.9), passes=("Object Index", "Depth"), alpha_threshold=1.0))
    surface = scenes.material(Closure(ClosureKind.TRANSPARENT, (0.9,) * 3))
    passes = session.render(dataclasses.replace(scene, materials=(surface,)), SETTINGS).passes
    assert not passes["Object Index"].any() and np.all(passes["Depth"] == 1e10)


@pytest.mark.parametrize("kind", [CameraKind.PERSPECTIVE, CameraKind.ORTHOGRAPHIC])
@pytest.mark.parametrize("filled", [False, True])
def test_vectors_of_the_background_are_those_of_what_is_far_away(session, kind, filled):
    """Of a camera that goes and turns about its view's axis, by 0.1 before and by 0.2 after. Volumes have none."""
    still = scenes.camera(eye=(0, 0, 3), up=(0, 1, 0), half_width=0.5)
    moved = []
    for angle in (-0.1, 0.2):
        turned = np.eye(4)
        turned[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        turned[:3, 3] = 5 * angle, 0, angle
        moved.append((np.vstack([still.transform, [0, 0, 0, 1]]) @ turned)[:3])
    view = dataclasses.replace(still, kind=kind, frames=np.array(moved))
    size = 8
    scene = scenes.scene([], view=view, frame=Frame(size, size, passes=("Combined", VECTOR)), world=0.3)
    if filled:
        scene = dataclasses.replace(
            scene,
            world=dataclasses.replace(
                scene.world, volume=Volume((Closure(ClosureKind.HENYEY_GREENSTEIN, (9.0,) * 3),))
            ),
        )
    found = session.render(scene, SETTINGS.replace(sample_count=64)).passes[VECTOR]
    x, y = np.meshgrid(*2 * [np.arange(size) + 0.5 - size / 2])
    expected = np.zeros((size, size, 4))
    if kind == CameraKind.PERSPECTIVE and not filled:
        for i, angle in enumerate((-0.1, 0.2)):
            there = np.stack([np.cos(angle) * x + np.sin(angle) * y - x, np.cos(angle) * y - np.sin(angle) * x - y], -1)
            expected[..., 2 * i : 2 * i + 2] = there if i == 0 else -there
        assert np.abs(expected).max() > 0.5
    assert found == pytest.approx(expected, abs=0.03)  # means over the pixel


def test_albedo_that_guides_a_denoiser_has_the_tint_of_glass(session):
    """As in Cycles: what is seen through glass counts by its albedo, and so does the light in it."""
    tint, white = np.array([0.5, 0.6, 0.7]), 0.3
    reflected = ((1.5 - 1) / (1.5 + 1)) ** 2
    glass = scenes.material(Closure(ClosureKind.GLASS, (1.0, 1.0, 1.0), roughness=0.0, ior=1.5, refraction=tuple(tint)))
    scene = looking_down(glass, passes=("Denoising Albedo",))
    passes = session.render(scene, SETTINGS.replace(sample_count=256)).passes
    seen = reflected + (1 - reflected) * tint
    assert passes["Combined"][..., :3].mean((0, 1)) == pytest.approx(white * seen, rel=0.01)
    assert passes["Denoising Albedo"].mean((0, 1)) == pytest.approx(white * seen**2, rel=0.01)


def with_aovs(surface, *values):
    """A material that writes `values` to its passes, and scatters as `surface` does."""
    builder = ProgramBuilder()
    for number, value in enumerate(values):
        builder.closure("aov", value, number)
    (closure,) = surface.closures
    builder.closure("diffuse", closure.weight, (0.0, 0.0, 0.0))
    return dataclasses.replace(surface, closures=(), kinds=(ClosureKind.DIFFUSE,), program=builder.finish())


def test_materials_write_their_own_passes(session):
    names = (f"{AOV_COLOR}hue", f"{AOV_VALUE}amount")
    surface = with_aovs(scenes.diffuse(0.6), (0.5, -1.0, 2.0), (0.25, 0.0, 0.0))
    passes = session.render(looking_down(surface, passes=names), SETTINGS).passes
    assert np.all(passes[names[0]] == (0.5, -1, 2, 1)) and np.all(passes[names[1]] == 0.25)
    plain = session.render(looking_down(scenes.diffuse(0.6), passes=names), SETTINGS).passes
    assert not plain[names[0]].any() and np.array_equal(plain["Combined"], passes["Combined"])
    unasked = session.render(looking_down(surface, passes=()), SETTINGS).passes
    assert np.array_equal(unasked["Combined"], passes["Combined"])
