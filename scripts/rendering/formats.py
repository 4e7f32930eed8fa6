"""Blender's file formats of pictures, and which passes they hold."""

from __future__ import annotations

import os

import bpy

from raybatch_addon.export.passes import wanted_passes
from rendering.request import Request, not_layered

LAYERED = "OPEN_EXR_MULTILAYER"
# Blender's formats by the extension that chooses them; the first one listed is taken
FORMATS = {
    ".png": ("PNG",),
    ".jpg": ("JPEG",),
    ".jpeg": ("JPEG",),
    ".exr": ("OPEN_EXR", LAYERED),
    ".tif": ("TIFF",),
    ".tiff": ("TIFF",),
    ".bmp": ("BMP",),
    ".tga": ("TARGA", "TARGA_RAW"),
    ".hdr": ("HDR",),
    ".webp": ("WEBP",),
    ".jp2": ("JPEG2000",),
}
# Extensions of pictures that other programs write
UNWRITTEN = {".gif", ".svg", ".pdf", ".psd", ".heic", ".avif", ".ico", ".ppm"}
# Formats whose pixels are whole numbers, which are written with 8 bits unless the file is set to that format
_WHOLE_NUMBERS = {"PNG", "TIFF", "JPEG2000"}


def picture_formats(out: str) -> tuple[str, ...]:
    """The formats that the extension of `out` stands for; empty if it has none that is known."""
    return FORMATS.get(os.path.splitext(out)[1].lower(), ())


def choose_format(scene: bpy.types.Scene, request: Request) -> None:
    """Let `scene` be written as the request's `out` says; raises `UsageError`."""
    if not request.out:
        return
    formats = picture_formats(request.out)
    if request.multilayer:
        if formats and LAYERED not in formats:
            raise not_layered(request.out)
        formats = (LAYERED,)
    if formats:
        set_format(scene, formats)


def set_format(scene: bpy.types.Scene, formats: tuple[str, ...]) -> None:
    """Take the first of `formats`, unless the file has one of them already."""
    image = scene.render.image_settings
    if image.file_format in formats:
        return
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE" if formats[0] == LAYERED else "IMAGE"
    image.file_format = formats[0]
    if formats[0] in _WHOLE_NUMBERS:
        image.color_depth = "8"


def unwritten_passes(scene: bpy.types.Scene, request: Request) -> str:
    """A note of passes that neither a file nor the compositor will hold: of those that were asked for, and where an
    OpenEXR file is written of the view layers' own; empty if there are none.
    """
    composited = scene.render.use_compositing and (
        getattr(scene, "compositing_node_group", None) or getattr(scene, "node_tree", None)
    )
    written = scene.render.image_settings.file_format if request.out else ""
    if request.film or composited or written == LAYERED:
        return ""
    names = dict.fromkeys(request.passes)
    if written in FORMATS[".exr"]:
        names |= dict.fromkeys(name for layer in scene.view_layers if layer.use for name in wanted_passes(layer))
    heated = {"Combined", *(name for name, _ in request.heat_maps)}
    unwritten = [name for name in names if name not in heated]
    if not unwritten:
        return ""
    return (
        f"{', '.join(unwritten)}: rendered, but written nowhere; give --film FILE.npz, or --multilayer with -o FILE.exr"
    )
