"""Bytes of image files are read as they are stored, where nothing else is in Blender's memory."""

import bpy
import imbuf
import numpy as np
import pytest

from raybatch_addon.export.images.files import stored_bytes, stored_pixels
from tests.blender.export.textures.test_image_textures import BYTES, OPAQUE, write_png

pytestmark = pytest.mark.skipif(not hasattr(imbuf.types.ImBuf, "with_buffer"), reason="Blender tells no bytes yet")


def loaded(path):
    """An image of which Blender has read nothing."""
    image = bpy.data.images.load(str(path))
    image.reload()
    assert not image.has_data
    return image


def written(folder, name, pixels, file_format):
    """A file that Blender writes."""
    height, width = pixels.shape[:2]
    made = bpy.data.images.new("made", width, height, alpha=True)
    made.pixels.foreach_set((pixels / np.float32(255)).ravel())
    made.filepath_raw, made.file_format = str(folder / name), file_format
    made.save()
    bpy.data.images.remove(made)
    return folder / name


def reported(image):
    """The bytes that Blender tells as float32, once it has read the image."""
    pixels, is_float = stored_pixels(image, None, 0, raw=False)
    assert not is_float
    return np.rint(pixels * 255).astype(np.uint8)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("name, file_format, pixels", [("a.png", "PNG", BYTES), ("a.jpg", "JPEG", OPAQUE)])
def test_bytes_are_those_that_blender_reports(tmp_path, name, file_format, pixels, packed):
    image = loaded(written(tmp_path, name, pixels, file_format))
    if packed:
        image.pack()
        image.reload()
    assert not image.has_data
    own = stored_bytes(image)
    assert own is not None and not image.has_data, "Blender's own numbers were not made"
    assert np.array_equal(own, reported(image))


def test_what_is_in_blenders_memory_counts(tmp_path):
    path = written(tmp_path, "a.png", BYTES, "PNG")
    image = loaded(path)
    assert image.size[0] == BYTES.shape[1], "which reads the file"
    write_png(path, OPAQUE[::-1].copy())
    assert stored_bytes(image) is None


def test_files_of_other_numbers_are_left_to_blender(tmp_path):
    write_png(tmp_path / "deep.png", BYTES.astype(np.uint16) * 257)
    assert stored_bytes(loaded(tmp_path / "deep.png")) is None
    (tmp_path / "cut.png").write_bytes((written(tmp_path, "a.png", BYTES, "PNG")).read_bytes()[:40])
    assert stored_bytes(loaded(tmp_path / "cut.png")) is None
    assert stored_bytes(loaded(written(tmp_path, "a.bmp", OPAQUE, "BMP"))) is None
    gone = loaded(written(tmp_path, "gone.png", BYTES, "PNG"))
    (tmp_path / "gone.png").unlink()
    assert stored_bytes(gone) is None
    assert stored_bytes(bpy.data.images.new("painted", 4, 4)) is None
