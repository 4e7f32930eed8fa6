"""The pass Vector against Cycles' own of the same .blend."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.blender.features.build import ball, diffuse, floor, look
from tests.blender.features.compare import add_world, set_alike
from tests.blender.passes import test_passes


def keyed(owner, path, *values):
    """Values of a property in the frames 1, 2 and 3."""
    for frame, value in enumerate(values, 1):
        setattr(owner, path, value)
        owner.keyframe_insert(path, frame=frame)


def moving(scene, camera_moves):
    """Balls that go, turn, and swell by a shape key, on a floor that stands still."""
    set_alike(scene, 32)
    add_world(scene, 1.0)
    floor()
    goes = diffuse(ball("Goes", (0, 0, 0.5), 0.5), (0.2, 0.3, 0.8))
    keyed(goes, "location", (-1.2, 0, 0.5), (-0.9, 0.1, 0.5), (-0.4, 0.1, 0.7))
    turns = diffuse(ball("Turns", (0.2, 0.4, 0.5), 0.5), (0.8, 0.3, 0.2))
    keyed(turns, "rotation_euler", (0, 0, 0), (0, 0.2, 0.3), (0, 0.2, 0.9))
    swells = diffuse(ball("Swells", (1.2, 0, 0.5), 0.4), (0.2, 0.8, 0.3))
    swells.shape_key_add(name="Basis")
    key = swells.shape_key_add(name="Wide")
    for point in key.data:
        point.co.x *= 1.5
    keyed(key, "value", 0.0, 0.4, 1.0)
    again = swells.copy()  # the mesh is shared
    again.location, again.scale = (0.3, -0.9, 0.25), (0.5, 0.5, 0.5)
    scene.collection.objects.link(again)
    look(scene, (0, -4.2, 2.0), (0, 0, 0.4), lens=45)
    if camera_moves:
        place = tuple(scene.camera.location)
        keyed(scene.camera, "location", (place[0] - 0.2, *place[1:]), place, (place[0], place[1] + 0.3, place[2]))
        keyed(scene.camera.data, "lens", 44.0, 45.0, 48.0)
    scene.frame_set(2)
    layer = scene.view_layers[0]
    layer.use_pass_vector = layer.use_pass_cryptomatte_object = True


def panorama(scene, kind):
    """Make the camera a panorama of this kind that is near the balls and turns."""
    camera = scene.camera
    camera.location, camera.rotation_euler = (0, -1.5, 0.8), (1.4, 0, 0.1)
    camera.animation_data_clear()
    keyed(camera, "location", (-0.1, -1.5, 0.8), (0, -1.5, 0.8), (0, -1.4, 0.8))
    keyed(camera, "rotation_euler", (1.4, 0, 0.1), (1.4, 0, 0.15), (1.4, 0.1, 0.2))
    camera.data.type = "PANO"
    settings = camera.data if hasattr(camera.data, "panorama_type") else camera.data.cycles
    settings.panorama_type = kind
    if kind == "EQUIRECTANGULAR":
        settings.longitude_min, settings.longitude_max, settings.latitude_min = -1.5, 1.2, -1.2
    elif kind == "CENTRAL_CYLINDRICAL":  # not the seam behind the camera, where what crosses it jumps
        settings.central_cylindrical_range_u_min, settings.central_cylindrical_range_u_max = -2.5, 2.0
    elif kind == "FISHEYE_EQUISOLID":
        settings.fisheye_lens = 16.0
    scene.frame_set(2)


@pytest.mark.parametrize(
    "camera", ["PERSP", pytest.param("ORTHO", marks=pytest.mark.thorough), pytest.param("", marks=pytest.mark.thorough)]
)
def test_vectors_are_those_of_cycles(scene, tmp_path, monkeypatch, camera, general_kernels):
    """`camera`: the kind of one that moves; none for one that stands still."""
    monkeypatch.setattr(test_passes, "SAMPLES", 32)
    moving(scene, bool(camera))
    if camera == "ORTHO":
        scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 4.0
    compare(scene, tmp_path)


@pytest.mark.parametrize(
    "kind",
    [
        "EQUIRECTANGULAR",
        *(
            pytest.param(kind, marks=pytest.mark.thorough)
            for kind in (
                "EQUIANGULAR_CUBEMAP_FACE",
                "MIRRORBALL",
                "FISHEYE_EQUIDISTANT",
                "FISHEYE_EQUISOLID",
                "FISHEYE_LENS_POLYNOMIAL",
                "CENTRAL_CYLINDRICAL",
            )
        ),
    ],
)
def test_vectors_of_panoramas_are_those_of_cycles(scene, tmp_path, monkeypatch, kind, general_kernels):
    monkeypatch.setattr(test_passes, "SAMPLES", 32)
    moving(scene, True)
    panorama(scene, kind)
    has_rim = kind in ("MIRRORBALL", "FISHEYE_EQUIDISTANT", "FISHEYE_EQUISOLID")  # in pixels with a part of the picture
    compare(scene, tmp_path, full_least=0.2, background=bpy.app.version >= (5, 2, 0) and not has_rim)


def compare(scene, tmp_path, full_least=0.4, background=False):
    """Render `scene` by both engines, whose vectors are the same where one object fills a pixel, as it does in this
    share of them, and with `background` where none is. (Cycles has no vectors of the background before 5.2, and there
    those of perspective cameras lack the division by the distance along the view.)
    """
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    pages = {
        engine: test_passes.rendered(scene, engine, tmp_path / f"{engine}.exr", 1) for engine in ("RAYBATCH", "CYCLES")
    }
    ours, theirs = pages["RAYBATCH"]["Vector"], pages["CYCLES"]["Vector"]
    assert ours.shape == theirs.shape
    # one object fills the pixel in both
    full = np.logical_and.reduce([np.abs(each["CryptoObject00"][..., 2] - 1) < 1e-6 for each in pages.values()])
    assert full.mean() > full_least and np.abs(theirs[full]).max() > 1
    if background:
        empty = np.logical_and.reduce([each["CryptoObject00"][..., 2] == 0 for each in pages.values()])
        empty[:2] = False  # the pole of a panorama may be there
        assert empty.any() and np.abs(theirs[empty]).max() > 1
        full |= empty
    difference = np.abs(ours - theirs)[full]
    print(difference.max(), difference.mean(), np.abs(theirs[full]).mean())
    assert (
        difference.mean() < 0.02 * np.abs(theirs[full]).mean() and difference.max() < 0.1 * np.abs(theirs[full]).max()
    )
