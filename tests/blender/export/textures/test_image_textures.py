"""Image and Environment Texture nodes: export and look-up agree with Cycles point by point.

Cycles gives the coordinates of every pixel along with the values, so that nothing but the texture is compared.
"""

import struct
import zlib

import bpy
import numpy as np
import OpenEXR
import pytest

from raybatch_addon.core.programs.ops.textures.environment import EnvironmentProjection
from raybatch_addon.core.programs.ops.textures.image import Projection
from raybatch_addon.core.shading.images.textures import Extension, Interpolation
from raybatch_addon.export.images.images import divides_alpha, export_image, forget_images
from tests.blender.export.textures.cycles_image_values import set_up, values_by_cycles
from tests.core.programs.image_probe import run_image_op

TOLERANCE = 1e-4  # absolute below 1, relative above
RNG = np.random.default_rng(5)
BYTES = RNG.integers(0, 256, (7, 9, 4)).astype(np.uint8)
BYTES[..., 3] = np.maximum(BYTES[..., 3], 8)  # values divided by a smaller alpha are rounding alone
OPAQUE = BYTES.copy()
OPAQUE[..., 3] = 255
MODES = ("STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE")
CODES = {
    "Linear": Interpolation.LINEAR,
    "Closest": Interpolation.CLOSEST,
    "Cubic": Interpolation.CUBIC,
    "Smart": Interpolation.CUBIC,
}
# the reference is Cycles since this version; before, it rounded other colour spaces to bytes and multiplied alpha
# elsewhere
since_5_2 = pytest.mark.skipif(
    bpy.app.version < (5, 2), reason="Cycles of older Blenders rounds and multiplies alpha elsewhere"
)


@pytest.fixture(autouse=True)
def nothing_kept():
    forget_images()
    yield
    forget_images()


def datablock(pixels=OPAQUE, space="sRGB", alpha="STRAIGHT", floats=False):
    """A generated image."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new("Painted", width, height, alpha=True, float_buffer=floats)
    image.colorspace_settings.name = space
    values = pixels / np.float32(255) if pixels.dtype == np.uint8 else pixels
    image.pixels.foreach_set(np.ascontiguousarray(values, np.float32).ravel())
    image.update()
    image.alpha_mode = alpha
    return image


def write_png(path, pixels):
    """`pixels` uint8 or uint16 [height, width, 4], bottom row first."""
    bits = 8 * pixels.dtype.itemsize
    rows = b"".join(b"\0" + row.astype(f">u{bits // 8}").tobytes() for row in pixels[::-1])

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    size = struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], bits, 6, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    )
    return path


def write_exr(path, pixels):
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGBA": np.ascontiguousarray(pixels[::-1], np.float32)}).write(
        str(path)
    )
    return path


def loaded(path, space, alpha="STRAIGHT"):
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name, image.alpha_mode = space, alpha
    return image


def assert_like_cycles(scene, tmp_path, image, uv=(-1.3, 2.1), alpha=True, frame=1, tolerance=TOLERANCE, **settings):
    """Compare an Image Texture node with these settings; the coordinates are the UV map."""
    _, tree = set_up(scene, uv)
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    for name, value in settings.items():
        owner, _, last = name.rpartition("__")
        setattr(getattr(node, owner) if owner else node, last, value)
    # Cycles leaves tiles out where it is sure that UV coordinates, and nothing else, do not reach them; it is wrong
    # about large triangles
    place = tree.nodes.new("ShaderNodeVectorMath")
    tree.links.new(tree.nodes.new("ShaderNodeUVMap").outputs[0], place.inputs[0])
    tree.links.new(place.outputs[0], node.inputs["Vector"])
    sockets = {
        "color": node.outputs["Color"],
        "place": place.outputs[0],
        **({"alpha": node.outputs["Alpha"]} if alpha else {}),
    }
    theirs = values_by_cycles(scene, tree, tmp_path, **sockets)
    exported, notes = export_image(image, node.image_user, frame)
    divide = alpha and divides_alpha(image)
    words = [0, CODES[node.interpolation], Extension[node.extension], Projection[node.projection], divide]
    assert_same(run_image_op("image", [exported], words, theirs["place"]), theirs, tolerance)
    return exported, notes


def assert_same(ours, theirs, tolerance=TOLERANCE):
    assert np.ptp(theirs["place"], axis=0).max() > 0
    expected = np.concatenate([theirs["color"], theirs.get("alpha", ours[:, 3:])[:, :1]], 1)
    error = np.abs(ours - expected) / np.maximum(1, np.abs(expected))
    print("worst", error.max())
    assert error.max() < tolerance


@pytest.mark.parametrize("extension", ["REPEAT", "EXTEND", "CLIP", "MIRROR"])
@pytest.mark.parametrize("interpolation", ["Linear", "Closest", "Cubic", "Smart"])
def test_interpolation_and_extension(scene, tmp_path, interpolation, extension):
    exported, notes = assert_like_cycles(scene, tmp_path, datablock(), interpolation=interpolation, extension=extension)
    assert exported.pixels.dtype == np.uint8 and notes == ()


@pytest.mark.parametrize("linked", [True, False])
@pytest.mark.parametrize("space", ["sRGB", "Non-Color"])
@pytest.mark.parametrize("mode", ["STRAIGHT", pytest.param("PREMUL", marks=since_5_2), "CHANNEL_PACKED", "NONE"])
@pytest.mark.parametrize("kind", ["generated", "packed", "file"])
def test_alpha_of_bytes(scene, tmp_path, kind, mode, space, linked):
    image = (
        datablock(BYTES, space, mode) if kind != "file" else loaded(write_png(tmp_path / "a.png", BYTES), space, mode)
    )
    if kind == "packed":
        image.pack()
    assert_like_cycles(scene, tmp_path, image, alpha=linked)


@since_5_2
@pytest.mark.parametrize("packed", [True, False])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("space", ["sRGB", "Linear Rec.709", "Non-Color"])
@pytest.mark.parametrize("kind", ["exr", "png"])
def test_alpha_of_floats(scene, tmp_path, kind, space, mode, packed):
    whole = RNG.integers(9000, 65536, (7, 9, 4)).astype(np.uint16)
    path = (
        write_png(tmp_path / "a.png", whole)
        if kind == "png"
        else write_exr(tmp_path / "a.exr", whole / 65535 * [1, 5, 0.2, 1])
    )
    image = loaded(path, space, mode)
    if packed:
        image.pack()
    assert_like_cycles(scene, tmp_path, image)


@since_5_2
@pytest.mark.parametrize("mode", MODES)
def test_alpha_of_painted_floats(scene, tmp_path, mode):
    assert_like_cycles(scene, tmp_path, datablock(RNG.uniform(0.2, 1, (7, 9, 4)), "Linear Rec.709", mode, floats=True))


@since_5_2
@pytest.mark.parametrize(
    "space",
    [
        "sRGB",
        "Non-Color",
        "Linear Rec.709",
        "ACEScg",
        "Linear Rec.2020",
        "Display P3",
        "Rec.1886",
        "Rec.2020",
        "Filmic Log",
        "Linear CIE-XYZ D65",
        "Gamma 2.2 Encoded Rec.709",
        "Filmic sRGB",
    ],
)
@pytest.mark.parametrize("mode", ["STRAIGHT", "CHANNEL_PACKED"])
def test_color_spaces_of_bytes(scene, tmp_path, space, mode):
    assert_like_cycles(scene, tmp_path, datablock(BYTES, space, mode))


@pytest.mark.parametrize("space", ["sRGB", "Linear Rec.709", "ACEScg", "Linear Rec.2020", "Display P3"])
def test_color_spaces_of_floats(scene, tmp_path, space):
    path = write_exr(tmp_path / "a.exr", np.concatenate([RNG.uniform(0, 5, (7, 9, 3)), np.ones((7, 9, 1))], 2))
    assert_like_cycles(scene, tmp_path, loaded(path, space, "PREMUL"))


def test_grey_images_take_one_channel(scene, tmp_path):
    grey = np.repeat(BYTES[..., :1], 4, 2)
    grey[..., 3] = 255
    exported, _ = assert_like_cycles(scene, tmp_path, loaded(write_png(tmp_path / "g.png", grey), "sRGB"))
    assert exported.pixels.shape == (7, 9, 1)


@pytest.mark.parametrize("alpha", ["STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE"])
@pytest.mark.parametrize("space", ["sRGB", "Non-Color"])
def test_opaque_bytes_take_three_channels(scene, tmp_path, space, alpha):
    path = write_png(tmp_path / "o.png", OPAQUE)
    exported, _ = assert_like_cycles(scene, tmp_path, loaded(path, space, alpha))
    assert exported.pixels.dtype == np.uint8 and np.array_equal(exported.pixels, OPAQUE[..., :3])


def test_half_precision_is_kept_where_it_is_exact(scene, tmp_path):
    values = RNG.uniform(0, 900, (7, 9, 4)).astype(np.float16).astype(np.float32)
    values[..., 3] = 1
    exported, _ = assert_like_cycles(
        scene, tmp_path, loaded(write_exr(tmp_path / "h.exr", values), "Linear Rec.709", "PREMUL")
    )
    assert exported.pixels.dtype == np.float16


@pytest.mark.parametrize("projection", ["SPHERE", "TUBE"])
def test_projections(scene, tmp_path, projection):
    assert_like_cycles(scene, tmp_path, datablock(), uv=(0.01, 0.98), projection=projection)


@pytest.mark.parametrize("blend", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("turn", [(0.3, 0.2, 0.1), (0.9, -0.6, 2.0), (-0.7, 0.75, -1.0)])
def test_box_projection(scene, tmp_path, turn, blend):
    plane, tree = set_up(scene, (0.0, 1.0))
    plane.rotation_euler, plane.scale = turn, (2.0, 1.5, -0.5)
    mesh = plane.data
    mesh.polygons[0].use_smooth = True
    mesh.normals_split_custom_set_from_vertices(
        [(-0.7, 0.2, 0.6), (0.8, 0.3, 0.4), (0.4, -0.9, 0.5), (-0.2, -0.3, 0.8)]
    )
    node, place = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeTexCoord")
    node.image, node.projection, node.projection_blend = datablock(), "BOX", blend
    tree.links.new(place.outputs["Generated"], node.inputs["Vector"])
    sockets = {"color": node.outputs["Color"], "place": place.outputs["Generated"], "normal": place.outputs["Normal"]}
    theirs = values_by_cycles(scene, tree, tmp_path, **sockets)
    met = np.any(theirs["normal"] != 0, 1)
    theirs = {name: values[met] for name, values in theirs.items()}
    exported, _ = export_image(node.image, node.image_user, 1)
    words = [0, Interpolation.LINEAR, Extension.REPEAT, 0, -1]
    assert_same(
        run_image_op("image_box", [exported], words, theirs["place"], theirs["normal"], constants=[blend]), theirs
    )


@pytest.mark.parametrize("interpolation", ["Linear", "Closest", "Cubic"])
@pytest.mark.parametrize("projection", ["EQUIRECTANGULAR", "MIRROR_BALL"])
def test_environment(scene, tmp_path, projection, interpolation):
    plane, tree = set_up(scene)
    plane.scale, plane.rotation_euler = (2, 2, 2), (0.7, 0.5, 0.1)
    node, place = tree.nodes.new("ShaderNodeTexEnvironment"), tree.nodes.new("ShaderNodeNewGeometry")
    node.image, node.projection, node.interpolation = datablock(), projection, interpolation
    tree.links.new(place.outputs["Position"], node.inputs["Vector"])
    theirs = values_by_cycles(scene, tree, tmp_path, color=node.outputs["Color"], place=place.outputs["Position"])
    exported, _ = export_image(node.image, node.image_user, 1)
    words = [0, CODES[interpolation], EnvironmentProjection[projection], 0]
    assert_same(run_image_op("environment", [exported], words, theirs["place"]), theirs)


def test_tiles(scene, tmp_path):
    for number in (1001, 1002, 1011):
        write_png(tmp_path / f"t.{number}.png", np.roll(OPAQUE, number, 1))
    image = bpy.data.images.load(str(tmp_path / "t.1001.png"))
    image.source = "TILED"
    for number in (1002, 1011):
        if image.tiles.get(number) is None:
            image.tiles.new(number)
    image.filepath = str(tmp_path / "t.<UDIM>.png")
    exported, notes = export_image(image, None, 1)
    assert [number for number, _ in exported.tiles] == [1001, 1002, 1011] and notes == ()
    assert all(np.array_equal(pixels, np.roll(OPAQUE, number, 1)[..., :3]) for number, pixels in exported.tiles)
    gone = (tmp_path / "t.1011.png").rename(tmp_path / "away.png")
    exported, notes = export_image(image, None, 1)
    assert exported.tiles[2] == (1011, None) and len(notes) == 1 and f"“{image.name}”, tile 1011" in notes[0]
    gone.rename(tmp_path / "t.1011.png")
    image.pack()
    for number in (1001, 1002, 1011):
        (tmp_path / f"t.{number}.png").unlink()
    exported, notes = assert_like_cycles(scene, tmp_path, image, uv=(-0.9, 2.7))
    assert [number for number, _ in exported.tiles] == [1001, 1002, 1011] and notes == ()


@pytest.mark.parametrize(
    "frame, settings",
    [
        (1, {}),
        (3, {}),
        (9, {}),
        (8, {"use_cyclic": True}),
        (4, {"frame_offset": 1}),
        (6, {"frame_start": 5}),
        (2, {"frame_start": 5}),
    ],
)
def test_frames_of_a_sequence(scene, tmp_path, frame, settings):
    for number in range(7):
        write_png(tmp_path / f"s{number:04}.png", np.roll(OPAQUE, number, 1))
    image = bpy.data.images.load(str(tmp_path / "s0001.png"))
    image.source = "SEQUENCE"
    scene.frame_set(frame)
    user = {
        "image_user__frame_duration": 5,
        "image_user__use_auto_refresh": True,
        **{f"image_user__{k}": v for k, v in settings.items()},
    }
    _, notes = assert_like_cycles(scene, tmp_path, image, frame=frame, **user)
    assert notes == ()


# --- images that are kept, and defects of images


def test_an_image_is_exported_once_while_it_is_the_same(scene, tmp_path):
    path = write_png(tmp_path / "a.png", OPAQUE)
    image = loaded(path, "sRGB")
    first, _ = export_image(image, None, 1)
    assert export_image(image, None, 1)[0] is first
    image.colorspace_settings.name = "Non-Color"
    second, _ = export_image(image, None, 1)
    assert second is not first and second.encoding != first.encoding
    write_png(path, np.roll(OPAQUE, 1, 0)[:5])
    image.reload()
    third, _ = export_image(image, None, 1)
    assert third.pixels.shape == (5, 9, 3)
    painted = datablock(OPAQUE)
    before, _ = export_image(painted, None, 1)
    assert export_image(painted, None, 1)[0] is before  # read again, and unchanged
    painted.pixels[0] = 0.0
    assert export_image(painted, None, 1)[0] is not before
    assert len(bpy.data.images) == 2  # none is left behind


def test_missing_images_are_named(scene, tmp_path):
    gone = bpy.data.images.new("Gone", 4, 4)
    gone.source, gone.filepath = "FILE", str(tmp_path / "gone.png")
    exported, notes = export_image(gone, None, 1)
    assert exported.pixels is None and len(notes) == 1 and "“Gone”" in notes[0] and "gone.png" in notes[0]
    exported, notes = export_image(bpy.data.images.new("Result", 4, 4), None, 1)
    assert exported.pixels is not None
    write_png(tmp_path / "s0001.png", OPAQUE)
    sequence = bpy.data.images.load(str(tmp_path / "s0001.png"))
    sequence.source = "SEQUENCE"
    node = set_up(scene)[1].nodes.new("ShaderNodeTexImage")
    node.image, node.image_user.frame_duration = sequence, 9
    exported, notes = export_image(sequence, node.image_user, 5)
    assert exported.pixels is None and "s0005.png" in notes[0]


def test_damaged_files_are_magenta(scene, tmp_path):
    path = tmp_path / "broken.png"
    path.write_bytes(write_png(tmp_path / "a.png", OPAQUE).read_bytes()[:40])
    exported, notes = export_image(bpy.data.images.load(str(path)), None, 1)
    assert exported.pixels is None and "broken.png" in notes[0]


def test_a_color_space_that_nobody_knows_is_taken_as_linear_and_named(scene, monkeypatch):
    from raybatch_addon.export.images import color_spaces

    def unknown(colors, name):
        raise ValueError(name)

    monkeypatch.setattr(color_spaces, "to_scene_linear", unknown)
    monkeypatch.setattr(color_spaces, "_known", {})
    exported, notes = export_image(datablock(OPAQUE, "ACEScg"), None, 1)
    assert np.array_equal(exported.pixels, OPAQUE[..., :3]) and "“ACEScg”" in notes[0] and "“Painted”" in notes[0]


def test_colors_that_cannot_be_converted_now_are_another_time(scene, monkeypatch):
    from raybatch_addon.export.images import color_spaces

    real, image = color_spaces.to_scene_linear, datablock(OPAQUE, "ACEScg")

    def not_now(colors, name):
        raise color_spaces.CannotConvertNow

    monkeypatch.setattr(color_spaces, "_known", {})
    monkeypatch.setattr(color_spaces, "to_scene_linear", not_now)
    exported, notes = export_image(image, None, 1)
    assert np.array_equal(exported.pixels, OPAQUE[..., :3]) and "“ACEScg”" in notes[0]
    monkeypatch.setattr(color_spaces, "to_scene_linear", real)
    exported, notes = export_image(image, None, 1)
    assert not np.array_equal(exported.pixels, OPAQUE[..., :3]) and notes == ()


def test_an_image_that_does_not_fit_in_memory_is_named(scene, monkeypatch):
    from raybatch_addon.export.images import images

    def exhausted(*_):
        raise MemoryError

    monkeypatch.setattr(images, "stored_pixels", exhausted)
    exported, notes = export_image(datablock(), None, 1)
    assert exported.pixels is None and "“Painted”" in notes[0] and "memory" in notes[0]
