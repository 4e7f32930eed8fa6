"""Shadow rays that begin above the faces of smooth meshes, and light from below the faces that counts."""

import dataclasses

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.scene.description import Frame, Scene
from raybatch_addon.core.scene.features import derive_features
from raybatch_addon.core.scene.flatten import flatten
from raybatch_addon.core.scene.geometry import Geometry, upload_geometry
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.bsdf.materials import ShadingFrame
from raybatch_addon.core.shading.terminator import lifted_share, make_terminator_lift
from tests.support import scenes
from tests.support.under_test import DEVICE

pytestmark = pytest.mark.usefixtures("general_kernels")
SETTINGS = RenderSettings(sample_count=4, bounce_max=0)


@pytest.fixture(scope="module")
def session():
    made = Session(DEVICE)
    yield made
    made.close()


def ball(cutoff: float | None, smooth=True, count=1) -> Scene:
    """A ball of few faces in the sun, seen from a side."""
    mesh = scenes.sphere("ball", 12, 6, smooth=smooth)
    objects = [(mesh, scenes.translation(0, 3 * i, 0), scenes.diffuse(0.8)) for i in range(count)]
    sun = scenes.sun(3.0, matrix=scenes.look_at((-4, 3, 1), (0, 0, 0)))
    made = scenes.scene(objects, view=scenes.camera(eye=(0, -4, 0.4)), frame=Frame(160, 160), lights=(sun,))
    cutoffs = None if cutoff is None else np.full(count, cutoff, np.float32)
    return dataclasses.replace(made, instances=dataclasses.replace(made.instances, terminator=cutoffs))


def picture(session: Session, scene: Scene, **change) -> np.ndarray:
    film = session.render(scene, SETTINGS.replace(**change))
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"][..., 0].astype(float)


def expected(session: Session, scene: Scene) -> np.ndarray:
    """Lambert's law by the normals of the surface that the ball stands for; 0 outside the ball."""
    frame = dataclasses.replace(scene.frame, passes=("Combined", "Normal"))
    normal = session.render(dataclasses.replace(scene, frame=frame), SETTINGS).passes["Normal"].astype(float)
    to_sun = scene.lights[0].transform[:, 2].astype(float)
    return 0.8 / np.pi * 3.0 * np.maximum(normal @ to_sun, 0)


@pytest.mark.parametrize("count", [1, 2])
def test_a_smooth_ball_is_lit_up_to_its_own_shade(session, count):
    """By its normals: its faces do not shade each other."""
    smooth = expected(session, ball(None, count=count))
    lit = smooth > 0.02
    at_faces, lifted = (picture(session, ball(cutoff, count=count)) for cutoff in (None, 0.1))
    assert (at_faces[lit] < 0.9 * smooth[lit]).mean() > 0.03  # where faces are turned away
    assert (lifted[lit] < 0.9 * smooth[lit]).mean() < 0.003
    # the law is about each sample's normal, and the pass has their mean in a pixel
    assert lifted.mean() == pytest.approx(smooth.mean(), rel=0.004)
    assert at_faces.mean() < 0.99 * lifted.mean()


@wp.kernel(**KERNEL_OPTIONS)
def _shares_kernel(cutoff: float, cosines: wp.array(dtype=wp.vec2), out: wp.array(dtype=float)):
    i = wp.tid()
    out[i] = lifted_share(cutoff, cosines[i][0], cosines[i][1])


def test_a_ray_is_lifted_the_less_the_higher_its_light():
    cosines = np.array([(0.05, -0.1), (0.05, 0.05), (0.05, 0.1), (0.3, -0.1), (0.3, 0.05), (0.3, 0.1)], np.float32)
    out = wp.zeros(len(cosines), dtype=float, device=DEVICE)
    wp.launch(
        _shares_kernel, len(cosines), [0.1, wp.array(cosines, dtype=wp.vec2, device=DEVICE)], [out], device=DEVICE
    )
    np.testing.assert_allclose(out.numpy(), [1, 1, 0.5, 1, 0.5, 0], atol=1e-5)


def test_lifts_are_between_the_faces_and_the_ball(session):
    """At corners there is none, and in the middles of faces it is most; light from the other side is met there."""
    scene = ball(0.1)
    lift = make_terminator_lift(False, False)

    @wp.kernel(**KERNEL_OPTIONS)
    def lifts(geometry: Geometry, side: float, out: wp.array2d(dtype=wp.vec3)):
        i, k = wp.tid()
        corners = geometry.triangles[i]
        a = geometry.positions[corners[0]]
        b = geometry.positions[corners[1]]
        c = geometry.positions[corners[2]]
        uv = wp.vec2(1.0 / 3.0, 1.0 / 3.0)
        if k < 3:
            uv = wp.vec2(float(k % 2), float(k // 2))
        frame = ShadingFrame()
        frame.geometric_normal = wp.normalize(wp.cross(b - a, c - a))
        frame.normal = frame.geometric_normal
        direction = side * 0.01 * frame.geometric_normal + wp.normalize(b - a)
        out[i, k] = lift(geometry, 0, i, uv, frame, wp.normalize(direction), 0.1, 0.0)

    geometry = upload_geometry(flatten(scene), scene, wp.get_device(DEVICE))
    mesh = scene.meshes[0]
    corners = mesh.positions[mesh.triangles].astype(float)
    middle = corners.mean(1)
    radius = np.linalg.norm(middle, axis=1)
    found = []
    for side in (1.0, -1.0):
        out = wp.zeros((len(mesh.triangles), 4), dtype=wp.vec3, device=DEVICE)
        wp.launch(lifts, out.shape, [geometry, side], [out], device=DEVICE)
        found.append(out.numpy().astype(float))
    above, below = found
    np.testing.assert_allclose(above[:, :3], 0, atol=1e-6)
    reached = np.linalg.norm(middle + above[:, 3], axis=1)
    assert (reached > radius + 0.1 * (1 - radius)).all() and (reached < 1 + 1.5 * (1 - radius)).all()
    assert ((below[:, 3] * middle).sum(1) <= 0).all() and (below[:, 3] != 0).any()


@pytest.mark.parametrize(
    "change", [{"batching": "ON", "treelet_size": 16}, {"tile_size": 7, "thread_count": 2}, {"ray_count": 100}], ids=str
)
def test_any_schedule_gives_the_same_film(session, change):
    scene = ball(0.1, count=2)
    np.testing.assert_array_equal(picture(session, scene, **change), picture(session, scene, batching="OFF"))


def test_scenes_without_lifts_have_no_code_for_them(session):
    assert derive_features(ball(0.1), SETTINGS).terminator
    for scene, settings in (
        (ball(0.0), SETTINGS),
        (ball(None), SETTINGS),
        (ball(0.1, smooth=False), SETTINGS),
        (ball(0.1), SETTINGS.replace(nee="OFF")),
    ):
        features = derive_features(scene, settings)
        assert not features.terminator and "lifts of shadow rays" in features.left_out()
    np.testing.assert_array_equal(picture(session, ball(0.1, smooth=False)), picture(session, ball(None, smooth=False)))
    np.testing.assert_array_equal(picture(session, ball(0.0)), picture(session, ball(None)))


def test_lifts_are_saved(tmp_path):
    save_scene(tmp_path / "scene.npz", ball(0.25), SETTINGS)
    np.testing.assert_array_equal(load_scene(tmp_path / "scene.npz")[0].instances.terminator, [0.25])
