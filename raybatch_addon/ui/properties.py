"""The settings at `scene.raybatch`, made from the core's definitions."""

from __future__ import annotations

import bpy

from ..core.settings import SETTINGS, SettingInfo


def device_names() -> list[tuple[str, str]]:
    """What may be chosen as device, and what it is; starts Warp."""
    import warp as wp

    from ..core.device import start_warp

    start_warp()
    choices = [("AUTO", "the first CUDA device, else the CPU"), ("cpu", "the processor")]
    return choices + [(device.alias, device.name) for device in wp.get_cuda_devices()]


def _search_devices(_self, _context, text: str):
    return [choice for choice in device_names() if text.lower() in choice[0].lower()]


def _property(info: SettingInfo):
    """Blender's property for one setting."""
    about = dict(name=info.label, description=_description(info), default=info.default, options=set())
    if info.name == "device":
        # Text with suggestions, not an enumeration: a file from a machine with other devices keeps what it
        # says, and the render names the devices that there are. Warp starts when the list is opened.
        return bpy.props.StringProperty(search=_search_devices, search_options={"SUGGESTION"}, **about)
    if info.choices:
        return bpy.props.EnumProperty(items=list(info.choices), **about)
    if info.kind is str:
        return bpy.props.StringProperty(**about)
    if info.kind is int:
        return bpy.props.IntProperty(min=int(info.minimum), max=int(info.maximum), **about)
    return bpy.props.FloatProperty(min=info.minimum, max=info.maximum, precision=3, **about)


def _description(info: SettingInfo) -> str:
    unit = f" [{info.unit}]" if info.unit else ""
    return f"{info.description}{unit}"


RayBatchSettings = type(
    "RayBatchSettings",
    (bpy.types.PropertyGroup,),
    {
        "__doc__": "RayBatch's settings of a scene.",
        "__annotations__": {name: _property(info) for name, info in SETTINGS.items()},
    },
)


def register() -> None:
    """Add `scene.raybatch`."""
    bpy.utils.register_class(RayBatchSettings)
    bpy.types.Scene.raybatch = bpy.props.PointerProperty(type=RayBatchSettings, name="RayBatch", description="Settings of RayBatch")


def unregister() -> None:
    """Remove `scene.raybatch`."""
    del bpy.types.Scene.raybatch
    bpy.utils.unregister_class(RayBatchSettings)
