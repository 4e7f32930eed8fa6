"""What Blender shows for images of libraries that are gone."""

import bpy

from raybatch_addon.core.scene.description import ImageEncoding
from raybatch_addon.export.images.images import export_image, forget_images


def test_what_stands_in_for_an_image_of_a_library_that_is_gone_is_the_same_from_the_first_time_on(scene, tmp_path):
    """Blender gives it a colour space with its pixels, which it makes when they are asked for."""
    forget_images()
    library = tmp_path / "library.blend"
    bpy.data.libraries.write(str(library), {bpy.data.images.new("Linked", 8, 8)})
    with bpy.data.libraries.load(str(library), link=True) as (_, into):
        into.images = ["Linked"]
    into.images[0].use_fake_user = True
    material = bpy.data.materials.new("User")
    material.use_fake_user = True
    material.use_nodes = True
    material.node_tree.nodes.new("ShaderNodeTexImage").image = into.images[0]
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "main.blend"))
    library.unlink()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "main.blend"))
    image = bpy.data.images["Linked"]
    assert image.is_missing and not image.colorspace_settings.name, "Blender has made it already"
    first, notes = export_image(image, None, 1)
    assert (first.encoding, notes) == (ImageEncoding.SRGB, ())
    assert export_image(image, None, 1)[0] is first
