"""Camera rays against geometry: window, clipping, depth of field."""

import dataclasses
import functools

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.errors import SceneError
from raybatch_addon.core.scene.description import Camera, CameraKind, Panorama, SphericalStereo
from raybatch_addon.core.shading.camera import CameraData, CameraFeatures, make_camera_ray, upload_camera
from raybatch_addon.core.shading.panorama import make_panorama_direction, panorama_numbers, panorama_place_of
from tests.support.under_test import BLOCK_DIM, DEVICE

DEVICES = [DEVICE]
WIDTH, HEIGHT = 64, 48


@functools.cache
def kernel_for(features: CameraFeatures):
    camera_ray = make_camera_ray(features)

    @wp.kernel(**KERNEL_OPTIONS)
    def shoot(
        camera: CameraData,
        pixel: wp.array(dtype=wp.vec2),
        lens: wp.array(dtype=wp.vec2),
        origin: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        t_max: wp.array(dtype=float),
    ):
        i = wp.tid()
        o, d, t = camera_ray(camera, pixel[i][0], pixel[i][1], lens[i])
        origin[i] = o
        direction[i] = d
        t_max[i] = t

    return shoot


def shoot(camera: Camera, pixel, lens=None, device=DEVICE):
    """Rays in the camera's own axes: origin, direction, t_max."""
    pixel = np.atleast_2d(np.asarray(pixel, np.float32))
    lens = np.zeros_like(pixel) if lens is None else np.asarray(lens, np.float32)
    count = len(pixel)
    out = [wp.zeros(count, dtype=t, device=device) for t in (wp.vec3, wp.vec3, float)]
    arrays = [wp.array(a, dtype=wp.vec2, device=device) for a in (pixel, lens)]
    kernel = kernel_for(CameraFeatures(camera.kind, camera.lens_radius > 0, camera.stereo is not None))
    data = upload_camera(camera, WIDTH, HEIGHT)
    wp.launch(kernel, count, [data, *arrays], out, device=device, block_dim=BLOCK_DIM)
    origin, direction, t_max = (a.numpy().astype(float) for a in out)
    m = np.asarray(camera.transform, float)
    inverse = np.linalg.inv(m[:, :3])
    return (origin - m[:, 3]) @ inverse.T, direction @ inverse.T, t_max


def turned(seed=4, scale=10.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.column_stack([q, rng.normal(size=3) * scale]).astype(np.float32)


WINDOW = (-0.7, 0.9, -0.4, 0.8)
CORNERS = [(0, 0), (WIDTH, HEIGHT), (WIDTH / 4, HEIGHT / 2)]
AT = np.array([(-0.7, -0.4), (0.9, 0.8), (-0.3, 0.2)])


@pytest.mark.parametrize("device", DEVICES)
def test_perspective_rays_pass_the_window_between_the_planes(device):
    camera = Camera(CameraKind.PERSPECTIVE, turned(), WINDOW, clip_start=0.5, clip_end=20.0)
    origin, direction, t_max = shoot(camera, CORNERS, device=device)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, rtol=1e-6)
    np.testing.assert_allclose(direction[:, :2] / -direction[:, 2:], AT, atol=1e-5)
    np.testing.assert_allclose(origin, np.column_stack([AT, -np.ones(3)]) * 0.5, atol=1e-5)
    np.testing.assert_allclose((origin + direction * t_max[:, None])[:, 2], -20, rtol=1e-5)


@pytest.mark.parametrize("device", DEVICES)
def test_orthographic_rays_are_parallel(device):
    camera = Camera(CameraKind.ORTHOGRAPHIC, turned(), WINDOW, clip_start=0.5)
    origin, direction, t_max = shoot(camera, CORNERS, device=device)
    np.testing.assert_allclose(direction, np.tile([0, 0, -1], (3, 1)), atol=1e-6)
    np.testing.assert_allclose(origin, np.column_stack([AT, np.full(3, -0.5)]), atol=1e-5)
    assert np.isinf(t_max).all()


@pytest.mark.parametrize("kind", [CameraKind.PERSPECTIVE, CameraKind.ORTHOGRAPHIC])
def test_depth_of_field_is_sharp_on_the_plane_of_focus_alone(kind):
    camera = Camera(
        kind, turned(), WINDOW, clip_start=0.1, clip_end=9.0, lens_radius=0.3, focus_distance=4.0, lens_ratio=2.0
    )
    lens = np.random.default_rng(0).uniform(size=(4000, 2))
    origin, direction, t_max = shoot(camera, np.tile([(WIDTH / 4, HEIGHT / 2)], (4000, 1)), lens)

    def at(depth):
        return (origin + direction * ((-depth - origin[:, 2]) / direction[:, 2])[:, None])[:, :2]

    focus = AT[2] * (4 if kind == CameraKind.PERSPECTIVE else 1)
    np.testing.assert_allclose(at(4.0), np.tile(focus, (4000, 1)), atol=1e-5)
    np.testing.assert_allclose(origin[:, 2], -0.1, atol=1e-5)
    np.testing.assert_allclose((origin + direction * t_max[:, None])[:, 2], -9, rtol=1e-5)
    # the lens itself: an ellipse of half the width, filled evenly
    point = at(0.0) - (0 if kind == CameraKind.PERSPECTIVE else focus)
    radius = np.hypot(point[:, 0] / 0.15, point[:, 1] / 0.3)
    assert 0.99 < radius.max() <= 1 + 1e-5
    assert abs((radius**2).mean() - 0.5) < 4 * np.sqrt(1 / 12 / 4000)
    np.testing.assert_allclose(point.mean(0), 0, atol=0.02)


PANORAMAS = [kind for kind in CameraKind if kind.is_panorama]
SEEN = Panorama(focal_length=20.0, polynomial=(0.0, -0.05, 0.0, 0.0, 0.0))


@functools.cache
def directions_kernel():
    """Where the points of a picture look in each kind of panorama, one kind after another."""
    functions = [make_panorama_direction(kind) for kind in PANORAMAS]
    a, b, c, d, e, f, g = functions

    @wp.kernel(**KERNEL_OPTIONS)
    def look(numbers: wp.array2d(dtype=wp.vec4), at: wp.array(dtype=wp.vec2), out: wp.array2d(dtype=wp.vec3)):
        i = wp.tid()
        x = at[i][0]
        y = at[i][1]
        out[0, i] = a(numbers[0, 0], numbers[0, 1], x, y)
        out[1, i] = b(numbers[1, 0], numbers[1, 1], x, y)
        out[2, i] = c(numbers[2, 0], numbers[2, 1], x, y)
        out[3, i] = d(numbers[3, 0], numbers[3, 1], x, y)
        out[4, i] = e(numbers[4, 0], numbers[4, 1], x, y)
        out[5, i] = f(numbers[5, 0], numbers[5, 1], x, y)
        out[6, i] = g(numbers[6, 0], numbers[6, 1], x, y)

    return look


def looked(at) -> np.ndarray:
    """Directions of all kinds: shape [kinds, points, 3]."""
    numbers = np.array([panorama_numbers(kind, SEEN) for kind in PANORAMAS], np.float32).reshape(-1, 2, 4)
    out = wp.zeros((len(PANORAMAS), len(at)), dtype=wp.vec3, device=DEVICE)
    given = [wp.array(numbers, dtype=wp.vec4, device=DEVICE), wp.array(at, dtype=wp.vec2, device=DEVICE)]
    wp.launch(directions_kernel(), len(at), given, [out], device=DEVICE, block_dim=BLOCK_DIM)
    return out.numpy().astype(float)


def test_panoramas_look_ahead_in_the_middle_and_to_their_sides():
    """Right of the middle is right, above it above."""
    seen = looked([(0.5, 0.5), (0.6, 0.5), (0.5, 0.6)])
    np.testing.assert_allclose(np.linalg.norm(seen, axis=2), 1, rtol=1e-6)
    np.testing.assert_allclose(seen[:, 0], np.tile([0, 0, -1], (len(PANORAMAS), 1)), atol=1e-6)
    assert (seen[:, 1, 0] > 0.1).all() and np.abs(seen[:, 1, 1]).max() < 1e-6
    assert (seen[:, 2, 1] > 0.1).all() and np.abs(seen[:, 2, 0]).max() < 1e-6


def test_beside_its_circle_a_panorama_sees_nothing():
    round_ones = [PANORAMAS.index(kind) for kind in (CameraKind.MIRROR_BALL, CameraKind.FISHEYE_EQUIDISTANT)]
    seen = looked([(0.01, 0.01), (0.98, 0.97)])
    assert (seen[round_ones] == 0).all() and (seen[PANORAMAS.index(CameraKind.EQUIRECTANGULAR)] != 0).any()


@wp.kernel(**KERNEL_OPTIONS)
def _places_kernel(
    kind: int, numbers: wp.array(dtype=wp.vec4), look: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.vec2)
):
    i = wp.tid()
    out[i] = panorama_place_of(kind, numbers[0], numbers[1], look[i])


def test_a_panorama_shows_each_direction_where_it_looks_along_it():
    at = np.random.default_rng(1).uniform(0.2, 0.8, (500, 2)).astype(np.float32)
    at[:3] = (0.5, 0.5), (0.5, 0.7), (0.3, 0.5)
    for kind, seen in zip(PANORAMAS, looked(at), strict=True):
        numbers = np.array(panorama_numbers(kind, SEEN), np.float32).reshape(2, 4)
        out = wp.zeros(len(at), dtype=wp.vec2, device=DEVICE)
        given = [wp.array(numbers, dtype=wp.vec4, device=DEVICE), wp.array(seen, dtype=wp.vec3, device=DEVICE)]
        wp.launch(_places_kernel, len(at), [int(kind), *given], [out], device=DEVICE, block_dim=BLOCK_DIM)
        there = np.linalg.norm(seen, axis=1) > 0
        assert there.mean() > 0.9, kind
        np.testing.assert_allclose(out.numpy()[there], at[there], atol=2e-6, err_msg=kind.name)


def test_rays_of_a_panorama_meet_on_the_sphere_of_focus():
    still = Camera(CameraKind.EQUIRECTANGULAR, turned(), (0, 1, 0, 1), panorama=SEEN)
    open_wide = dataclasses.replace(still, lens_radius=0.3, focus_distance=4.0, lens_ratio=2.0)
    lens = np.random.default_rng(0).uniform(size=(500, 2))
    pixels = np.tile([(0.3 * WIDTH, 0.6 * HEIGHT)], (500, 1))
    _, ahead, _ = shoot(still, pixels[:1])
    origin, direction, _ = shoot(open_wide, pixels, lens)
    np.testing.assert_allclose(np.cross(4.0 * ahead - origin, direction), 0, atol=1e-5)
    np.testing.assert_allclose(origin @ ahead[0], 0, atol=1e-5)
    assert 0.29 < np.linalg.norm(origin, axis=1).max() <= 0.3 + 1e-5


def test_eyes_of_spherical_stereo_are_beside_every_ray():
    eye = SphericalStereo(offset=0.1, convergence_distance=2.0)
    camera = Camera(CameraKind.EQUIRECTANGULAR, turned(), (0, 1, 0, 1), stereo=eye)
    pixels = [(x, HEIGHT / 2) for x in np.linspace(1, WIDTH - 1, 7)]
    _, ahead, _ = shoot(dataclasses.replace(camera, stereo=None), pixels)
    origin, direction, _ = shoot(camera, pixels)
    np.testing.assert_allclose(origin, 0.1 * np.cross(ahead, [0, 1, 0]), atol=1e-5)
    np.testing.assert_allclose(np.cross(2.0 * ahead - origin, direction), 0, atol=1e-5)


def test_aperture_blades():
    """A triangle whose edge's middle lies at the angle of rotation, its corners on the circle."""
    camera = Camera(
        CameraKind.PERSPECTIVE,
        np.eye(3, 4, dtype=np.float32),
        WINDOW,
        lens_radius=2.0,
        blade_count=3,
        blade_rotation=0.3,
    )
    lens = np.random.default_rng(1).uniform(size=(20000, 2))
    origin, _direction, _ = shoot(camera, np.tile([(10, 10)], (20000, 1)), lens)
    point = origin[:, :2] / 2
    for k in range(3):
        angle = 0.3 + k * 2 * np.pi / 3
        along = point @ [np.cos(angle), np.sin(angle)]
        assert np.cos(np.pi / 3) - 0.02 < along.max() <= np.cos(np.pi / 3) + 1e-5
        corner = point @ [np.cos(angle + np.pi / 3), np.sin(angle + np.pi / 3)]
        assert 0.97 < corner.max() <= 1 + 1e-5
    # uniform: the inscribed circle holds its share of the triangle's area
    share = (np.hypot(*point.T) < 0.5).mean()
    expected = np.pi * 0.25 / (3 * np.sqrt(3) / 4)
    assert abs(share - expected) < 4 * np.sqrt(expected * (1 - expected) / 20000)


def test_cameras_that_see_nothing_are_refused():
    eye = np.eye(3, 4, dtype=np.float32)
    for broken in (
        dict(transform=np.zeros((3, 4), np.float32)),
        dict(transform=np.full((3, 4), np.nan, np.float32)),
        dict(window=(0.0, 0.0, -1.0, 1.0)),
        dict(clip_start=5.0, clip_end=5.0),
    ):
        with pytest.raises(SceneError, match="camera"):
            upload_camera(
                Camera(**{**dict(kind=CameraKind.PERSPECTIVE, transform=eye, window=WINDOW), **broken}), WIDTH, HEIGHT
            )
