"""Panels of panoramic cameras and of motion blur, whose settings Blender shows to its own engines alone."""

from __future__ import annotations

import bpy

from ...export.panorama import panorama_settings
from ..panel import EnginePanel, draw_below_name, draw_lines, draw_why, register_all, split_layout, unregister_all

_POLYNOMIAL = "fisheye_polynomial_"
# Settings of each type of panorama
_PANORAMAS = {
    "EQUIRECTANGULAR": ("latitude_min", "latitude_max", "longitude_min", "longitude_max"),
    "FISHEYE_EQUIDISTANT": ("fisheye_fov",),
    "FISHEYE_EQUISOLID": ("fisheye_lens", "fisheye_fov"),
    "FISHEYE_LENS_POLYNOMIAL": ("fisheye_fov", *(f"{_POLYNOMIAL}k{power}" for power in range(5))),
    "CENTRAL_CYLINDRICAL": (
        *(f"central_cylindrical_range_{axis}_{end}" for axis in "vu" for end in ("min", "max")),
        "central_cylindrical_radius",
    ),
}


class RAYBATCH_CAMERA_PT_panorama(EnginePanel, bpy.types.Panel):
    """The projection of a panoramic camera."""

    bl_label = "Panorama"
    bl_context = "data"
    bl_parent_id = "DATA_PT_lens"

    @classmethod
    def poll(cls, context):
        return super().poll(context) and context.camera is not None and context.camera.type == "PANO"

    def draw(self, context):
        layout = split_layout(self.layout)
        settings = panorama_settings(context.camera)
        if settings is None:
            draw_lines(layout, context, ["Enable the add-on Cycles, which has the settings"], "INFO")
            return
        draw_below_name(layout, settings, "panorama_type", "Panorama Type")
        for name in _PANORAMAS.get(settings.panorama_type, ()):
            short = {"text": name.removeprefix(_POLYNOMIAL).upper()} if name.startswith(_POLYNOMIAL) else {}
            layout.prop(settings, name, **short)


class RAYBATCH_RENDER_PT_motion_blur(EnginePanel, bpy.types.Panel):
    """The shutter."""

    bl_label = "Motion Blur"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context):
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context):
        layout = split_layout(self.layout)
        render = context.scene.render
        layout.active = render.use_motion_blur
        layout.prop(render, "motion_blur_position", text="Position")
        layout.prop(render, "motion_blur_shutter")
        cycles = getattr(context.scene, "cycles", None)
        if cycles is not None:
            layout.prop(cycles, "rolling_shutter_type")
            if cycles.rolling_shutter_type != "NONE":
                layout.prop(cycles, "rolling_shutter_duration", text="Duration")
        layout.template_curve_mapping(render, "motion_blur_shutter_curve")


class RAYBATCH_OBJECT_PT_motion_blur(EnginePanel, bpy.types.Panel):
    """What an object says of its motion: settings of Cycles."""

    bl_label = "Motion Blur"
    bl_context = "object"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return super().poll(context) and getattr(context.object, "cycles", None) is not None

    def draw_header(self, context):
        self.layout.prop(context.object.cycles, "use_motion_blur", text="")

    def draw(self, context):
        layout = split_layout(self.layout, animated=True)
        cycles = context.object.cycles
        is_blurred = context.scene.render.use_motion_blur
        layout.active = is_blurred and cycles.use_motion_blur
        layout.prop(cycles, "motion_steps", text="Steps")
        if context.object.type != "CAMERA":
            layout.prop(cycles, "use_deform_motion", text="Deformation")
        draw_why(layout, context, "" if is_blurred else "Unused with Motion Blur of the scene off")


_classes = (RAYBATCH_CAMERA_PT_panorama, RAYBATCH_RENDER_PT_motion_blur, RAYBATCH_OBJECT_PT_motion_blur)


def register() -> None:
    """Add the panels."""
    register_all(_classes)


def unregister() -> None:
    """Remove the panels."""
    unregister_all(_classes)
