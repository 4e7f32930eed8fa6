"""Scenes whose surfaces and world show images, from the description to the film."""

import numpy as np
import pytest

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.textures.environment import EnvironmentProjection
from raybatch_addon.core.programs.ops.textures.image import Projection
from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.scene.description import (
    Camera,
    CameraKind,
    ClosureKind,
    Frame,
    Image,
    ImageEncoding,
    Instances,
    Material,
    Mesh,
    Scene,
    Visibility,
    World,
)
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.core.shading.images.textures import Extension, Interpolation
from raybatch_addon.core.wavefront.scene.scene_cache import SceneCache

pytestmark = pytest.mark.usefixtures("general_kernels_of_module")

SETTINGS = RenderSettings(
    sample_count=1, bounce_max=0, pixel_filter="BOX"
)  # every ray stays in its pixel, which is one texel
PICTURE = np.random.default_rng(2).random((6, 6, 3)).astype(np.float32)


def image_program(place=0, interpolation=Interpolation.CLOSEST):
    builder = ProgramBuilder()
    color, _ = builder.value(
        "image", place, interpolation, Extension.REPEAT, Projection.FLAT, 0, builder.value("object_coordinates", 0)
    )
    builder.closure("emission", color)
    return builder.finish()


def sheet(image: Image, world=None, **program) -> Scene:
    """A square from 0 to 1 that emits `image` once, seen so that a pixel is a texel of a 6 x 6 image."""
    mesh = Mesh(
        "sheet",
        np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    one = np.zeros(1, np.int32)
    above = np.array([[1, 0, 0, 0.5], [0, 1, 0, 0.5], [0, 0, 1, 1]], np.float32)
    return Scene(
        camera=Camera(CameraKind.ORTHOGRAPHIC, above, (-0.5, 0.5, -0.5, 0.5)),
        frame=Frame(6, 6),
        meshes=(mesh,),
        instances=Instances(
            one, np.eye(3, 4, dtype=np.float32)[None], one, np.full(1, int(Visibility.ALL), np.int32), one
        ),
        slot_materials=one,
        materials=(Material("shows an image", (), (ClosureKind.EMISSION,), image_program(**program)),),
        images=(image,),
        world=world or World(),
        object_names=("sheet",),
    )


def picture_of(film):
    return film.passes["Combined"][..., :3]


def test_a_surface_shows_its_image(session):
    film = session.render(sheet(Image("picture", PICTURE)), SETTINGS)
    assert np.allclose(picture_of(film), PICTURE, atol=1e-6)
    assert film.statistics["images"] == {"count": 1, "bytes": pytest.approx(6 * 6 * 16, abs=100)}


def test_other_images_need_no_other_kernels(session):
    first = session.render(sheet(Image("picture", PICTURE)), SETTINGS)
    other = Image("bytes", np.arange(36, dtype=np.uint8).reshape(6, 6, 1), ImageEncoding.SRGB)
    second = session.render(sheet(other, interpolation=Interpolation.CUBIC), SETTINGS)
    assert first.statistics["modules"] == second.statistics["modules"]
    assert not np.allclose(picture_of(first), picture_of(second))


def test_a_saved_scene_shows_the_same_images(session, tmp_path):
    tiles = Image("tiles", None, ImageEncoding.SRGB, ((1001, np.arange(48, dtype=np.uint8).reshape(4, 4, 3)),))
    for image in (Image("picture", PICTURE.astype(np.float16)), tiles):
        scene = sheet(image)
        save_scene(tmp_path / "s.npz", scene, SETTINGS)
        back, settings = load_scene(tmp_path / "s.npz")
        assert np.array_equal(picture_of(session.render(scene, SETTINGS)), picture_of(session.render(back, settings)))


def test_an_image_with_infinities_is_repaired_and_named(session):
    pixels = PICTURE.copy()
    pixels[2, 3, 1], pixels[4, 1, 0] = np.inf, np.nan
    film = session.render(sheet(Image("Sky.hdr", pixels)), SETTINGS)
    (warning,) = [line for line in film.statistics["warnings"] if "Sky.hdr" in line]
    assert "2 texels" in warning and film.statistics["invalid_samples"] == 0
    assert np.all(picture_of(film)[2, 3] == 0) and np.allclose(picture_of(film)[0], PICTURE[0], atol=1e-6)


def test_an_image_that_is_not_there_is_magenta(session):
    assert np.all(picture_of(session.render(sheet(Image("gone")), SETTINGS)) == (1, 0, 1))
    assert np.all(picture_of(session.render(sheet(Image("other", PICTURE), place=7), SETTINGS)) == (1, 0, 1))


def test_an_image_too_large_for_the_device_is_made_smaller_and_named(session, monkeypatch):
    monkeypatch.setattr(SceneCache, "image_budget", lambda self, device: 40_000)
    film = session.render(sheet(Image("Large", np.full((120, 120, 4), 51, np.uint8))), SETTINGS)
    assert np.allclose(picture_of(film), 0.2)
    why, what = [line for line in film.statistics["warnings"] if "Large" in line]
    assert "“Large”, of a material that emits" in why and "120 x 120 to 60 x 60" in what


def test_a_world_shows_its_image(session):
    builder = ProgramBuilder()
    direction = builder.value("position", 0)
    color, _ = builder.value(
        "environment", 0, Interpolation.CLOSEST, EnvironmentProjection.EQUIRECTANGULAR, 0, direction
    )
    builder.closure("emission", color)
    below = np.zeros((2, 1, 3), np.float32)
    below[0] = (3, 2, 1)  # the lower half: the camera looks down
    scene = Scene(
        camera=Camera(CameraKind.PERSPECTIVE, np.eye(3, 4, dtype=np.float32), (-1, 1, -1, 1)),
        frame=Frame(4, 4),
        images=(Image("world", below),),
        world=World(program=builder.finish()),
    )
    assert np.allclose(picture_of(session.render(scene, SETTINGS)), (3, 2, 1))
