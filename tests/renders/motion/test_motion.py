"""Things that move while the shutter is open, against closed forms; films under schedules."""

from dataclasses import replace

import numpy as np
import pytest

from raybatch_addon.core.scene.description import Frame, Scene, Shutter
from raybatch_addon.core.scene.motion import instance_maps
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

WIDTH = 32
SETTINGS = RenderSettings(sample_count=256, pixel_filter="BOX", filter_width=1.0, bounce_max=2)
pytestmark = pytest.mark.usefixtures("general_kernels")


@pytest.fixture(scope="module")
def session(device):
    opened = Session(device)
    yield opened
    opened.close()


def moved(*offsets, first=scenes.IDENTITY) -> np.ndarray:
    """Maps at evenly spaced times, `first` and so much further along x: float32, shape [steps, 3, 4]."""
    maps = np.repeat(np.asarray(first, np.float32)[None], len(offsets), 0)
    maps[:, 0, 3] += np.array(offsets, np.float32)
    return maps


def with_motion(scene: Scene, *maps) -> Scene:
    """`scene` with instances that move by `maps`, each of shape [steps, 3, 4]."""
    motion = np.stack(maps)
    middle = motion[:, motion.shape[1] // 2]
    return replace(scene, instances=replace(scene.instances, motion=instance_maps(motion), transform=middle))


def bright_plate() -> Scene:
    """A plate of size 1 that shines with radiance 1, in the middle of a view 4 wide and high from above."""
    view = scenes.camera(eye=(0, 0, 4), target=(0, 0, 0), half_width=0.5, up=(0, 1, 0))
    plate = (scenes.plane(size=1.0), scenes.IDENTITY, scenes.emitter(1.0))
    return scenes.scene([plate], view=view, frame=Frame(WIDTH, WIDTH))


def middle_row(session, scene, settings=SETTINGS) -> np.ndarray:
    """Radiance along the row through the middle of the picture: shape [WIDTH]."""
    film = session.render(scene, settings)
    assert film.statistics["invalid_samples"] == 0
    return film.passes["Combined"][WIDTH // 2 - 2 : WIDTH // 2 + 2, :, 0].mean(0)


def coverage(distance: float) -> np.ndarray:
    """The share of time for which a plate of size 1 covers each column, on its way of `distance` through the middle."""
    x = np.linspace(-2, 2, WIDTH * 64 + 1)
    x = ((x[1:] + x[:-1]) / 2).reshape(WIDTH, 64)
    low, high = np.clip((x - 0.5) / distance + 0.5, 0, 1), np.clip((x + 0.5) / distance + 0.5, 0, 1)
    return (high - low).mean(1)


def test_a_plate_covers_pixels_for_as_long_as_it_is_there(session):
    scene = with_motion(bright_plate(), moved(-1, 0, 1))
    np.testing.assert_allclose(middle_row(session, scene), coverage(2.0), atol=0.02)


def test_vertices_that_move_cover_pixels_like_a_plate_that_does(session):
    scene = bright_plate()
    (mesh,) = scene.meshes
    steps = np.stack([mesh.positions + np.array([x, 0, 0], np.float32) for x in (-1, 0, 1)])
    deforming = replace(scene, meshes=(replace(mesh, motion=steps),))
    row = middle_row(session, deforming)
    np.testing.assert_allclose(row, coverage(2.0), atol=0.02)
    np.testing.assert_allclose(row, middle_row(session, with_motion(scene, moved(-1, 0, 1))), atol=1e-6)


def test_a_camera_that_pans_sees_the_same_the_other_way(session):
    scene = bright_plate()
    view = replace(scene.camera, motion=moved(1, 0, -1, first=scene.camera.transform))
    np.testing.assert_allclose(middle_row(session, replace(scene, camera=view)), coverage(2.0), atol=0.02)


def test_a_shutter_that_is_open_at_one_time_alone_makes_a_sharp_picture(session):
    scene = with_motion(bright_plate(), moved(-1, 0, 1))
    shutter = Shutter(times=np.array([0.75, 0.75], np.float32))
    row = middle_row(session, replace(scene, camera=replace(scene.camera, shutter=shutter)))
    still = middle_row(session, with_motion(bright_plate(), moved(0.5, 0.5, 0.5)))
    np.testing.assert_allclose(row, still, atol=1e-6)


def test_rows_of_a_rolling_shutter_are_taken_one_after_another(session):
    scene = with_motion(bright_plate(), moved(-1, 0, 1))
    scene = replace(scene, camera=replace(scene.camera, shutter=Shutter(rolling=0.0)))
    picture = session.render(scene, SETTINGS).passes["Combined"][..., 0]
    x = np.linspace(-2, 2, 2 * WIDTH + 1)[1::2]
    rows = range(WIDTH // 2 - 3, WIDTH // 2 + 3)  # from below: the top is first
    for row in rows:
        centre = (picture[row] * x).sum() / picture[row].sum()
        assert centre == pytest.approx(1 - 2 * row / WIDTH, abs=0.05)


def test_a_turning_plate_goes_along_an_arc(session):
    """A small plate that turns about the camera's axis in three steps: all of it is on a ring."""
    angles = np.radians([0, 120, 240])
    maps = np.stack(
        [[[np.cos(a), -np.sin(a), 0, 0], [np.sin(a), np.cos(a), 0, 0], [0, 0, 1, 0]] for a in angles]
    ).astype(np.float32)
    scene = bright_plate()
    (mesh,) = scene.meshes
    mesh = replace(mesh, positions=0.25 * mesh.positions + np.array([1.25, 0, 0], np.float32))
    picture = session.render(with_motion(replace(scene, meshes=(mesh,)), maps), SETTINGS).passes["Combined"][..., 0]
    x = np.linspace(-2, 2, 2 * WIDTH + 1)[1::2]
    radius = np.hypot(*np.meshgrid(x, x))
    assert (picture * (np.abs(radius - 1.25) > 0.3)).sum() == 0
    # as bright as the plate is large, in pixels; about 1,000 samples meet it: three standard errors are 0.1 of it
    assert picture.sum() == pytest.approx(0.25**2 * (WIDTH / 4) ** 2, rel=0.1)


def moving_scene() -> Scene:
    """A ball that turns and grows, one that deforms, and a lamp and a floor that stand still."""
    ball = scenes.sphere(segments=24, rings=12, smooth=True)
    bulge = np.stack([ball.positions * np.array([1, 1, s], np.float32) for s in (0.6, 0.8, 1.1, 1.2, 0.9)])
    view = scenes.camera(eye=(0, -7, 3), target=(0, 0, 0.4))
    objects = [
        (ball, scenes.translation(-1.2, 0, 0), scenes.diffuse((0.8, 0.4, 0.2))),
        (replace(ball, name="bulge", motion=bulge), scenes.translation(1.2, 0, 0), scenes.diffuse(0.6)),
        (scenes.plane(size=12.0), scenes.translation(0, 0, -1), scenes.diffuse(0.5)),
    ]
    made = scenes.scene(objects, view=view, frame=Frame(24, 18), lights=[scenes.area_light(8.0, 1.0)], world=0.2)
    ways = [np.repeat(each[None], 3, 0) for each in made.instances.transform]
    for step, angle in enumerate((0.0, 0.7, 2.0)):
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        ways[0][step, :, :3] = turn * (0.6 + 0.2 * step)
        ways[0][step, 2, 3] += 0.5 * step
    moving = with_motion(made, *ways)
    return replace(moving, camera=replace(view, motion=moved(-0.1, 0.1, first=view.transform)))


def test_any_schedule_gives_the_same_film(session):
    scene, settings = moving_scene(), SETTINGS.replace(sample_count=4)
    plain = session.render(scene, settings).passes["Combined"]
    assert plain[..., :3].std() > 0.05
    for changes in (
        {"tile_size": 8, "sample_order": "FRAME_FIRST"},
        {"ray_count": 512, "ray_sort": "ON", "thread_count": 2},
        {"spatial_splits": "ON", "single_lane": "ON"},
        {"counters": "ON", "sample_order": "PIXEL_FIRST"},
        {"batching": "ON", "treelet_size": 6},
        {"batching": "ON", "treelet_size": 6, "ray_storage": "DIRECT"},
        {"batching": "ON", "geometry_budget": 60_000, "geometry_store": "HOST"},
    ):
        film = session.render(scene, settings.replace(**changes))
        np.testing.assert_array_equal(film.passes["Combined"], plain)
        statistics = film.statistics
        assert ("batching" in changes) == (statistics["batching"] is not None)
        assert ("geometry_budget" in changes) == ("pages" in statistics["tree"])


def test_a_part_of_the_frame_is_that_part_of_the_picture(session):
    scene, settings = moving_scene(), SETTINGS.replace(sample_count=4)
    whole = session.render(scene, settings).passes["Combined"]
    part = session.render(replace(scene, frame=replace(scene.frame, border=(4, 3, 17, 11))), settings)
    np.testing.assert_array_equal(part.passes["Combined"], whole[3:11, 4:17])


def test_warps_tree_is_reported_not_to_know_of_motion(session):
    film = session.render(moving_scene(), SETTINGS.replace(sample_count=1, batching="REFERENCE"))
    assert any("batching is OFF, not REFERENCE" in text for text in film.statistics["warnings"])


@pytest.mark.parametrize("way", ["far", "collapsing", "flipped"])
def test_extreme_motion_gives_finite_pictures(session, way):
    scene = moving_scene()
    motion = scene.instances.motion.maps.copy()
    if way == "far":
        motion[0, :, 0, 3] = (-5e4, 0, 5e4)
    elif way == "collapsing":
        motion[0, 1, :, :3] = 0
    else:
        motion[0, 2, :, :3] *= -1
    scene = replace(scene, instances=replace(scene.instances, motion=instance_maps(motion)))
    film = session.render(scene, SETTINGS.replace(sample_count=8))
    assert film.statistics["invalid_samples"] == 0 and np.isfinite(film.passes["Combined"]).all()


def test_a_scene_that_stands_still_keeps_nothing_of_motion(session):
    scene = bright_plate()
    left_out = session.render(scene, SETTINGS.replace(sample_count=1)).statistics["left_out"]
    assert {"motion of objects", "motion of the camera"} <= set(left_out)
