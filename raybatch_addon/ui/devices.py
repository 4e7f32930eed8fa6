"""The list of devices in the panel Device: a button for each, with its name and memory, and where there are several
CUDA devices a tick for those that share each picture.
"""

from __future__ import annotations

import bpy

from ..blender.devices import DeviceChoice, device_choices

CHOICE = "device_choice"  # the property: a view of `device`, which is text, as devices differ from computer to computer
_LOOK_SECONDS = 0.2
_shown: list[tuple[str, str, str, str, int]] = []  # Blender does not keep the texts of an enumeration's items


def choices_for(value: str) -> list[DeviceChoice]:
    """The devices that there are, and `value` if it is none of them."""
    found = list(device_choices() or ())
    names = {each.name.lower() for each in found}
    if value.lower() not in names:
        together = _together(value)
        if found and len(together) > 1 and names.issuperset(together):
            found.append(DeviceChoice(value, f"Together: {', '.join(together)}", "These share each picture"))
        elif found and together == ["all"]:
            found.append(DeviceChoice(value, "All CUDA devices", "All of the first one's model share each picture"))
        else:
            text = f"{value}: not on this computer" if found else "Looking for devices"
            found.append(DeviceChoice(value, text, "Choose one of the others"))
    return found


def _together(value: str) -> list[str]:
    """The names in a value of `device`."""
    return [each.strip().lower() for each in value.split(",")]


class RAYBATCH_OT_share_device(bpy.types.Operator):
    """Let this device share each picture with the others that are ticked"""

    bl_idname = "raybatch.share_device"
    bl_label = "Share the Picture"
    bl_options = {"UNDO", "INTERNAL"}

    name: bpy.props.StringProperty()

    def execute(self, context):
        properties = context.scene.raybatch
        ticked = _ticked(properties.device) ^ {self.name}
        order = [each.name for each in device_choices() or () if each.name in ticked]
        properties.device = ",".join(order) or "AUTO"
        return {"FINISHED"}


def _ticked(value: str) -> set[str]:
    """The devices that render by a value of `device`; none where it is AUTO."""
    cuda = {each.name for each in device_choices() or () if each.name.startswith("cuda")}
    names = set(_together(value))
    return cuda if names == {"all"} else names - {"auto"}


def _items(properties, _context) -> list[tuple[str, str, str, str, int]]:
    known = device_choices() or ()
    _shown[:] = [
        (each.name, each.label, each.description, "NONE" if each in known else "ERROR", number)
        for number, each in enumerate(choices_for(properties.device))
    ]
    return _shown


def _get(properties) -> int:
    names = [each.name.lower() for each in choices_for(properties.device)]
    return names.index(properties.device.lower())


def _set(properties, number: int) -> None:
    properties.device = choices_for(properties.device)[number].name


def device_choice_property():
    """The property `device_choice`."""
    return bpy.props.EnumProperty(
        name="Device", description="Where to render", items=_items, get=_get, set=_set, options=set()
    )


def draw_devices(layout, context) -> None:
    """A button for each device; where they are not known yet it says so until they are."""
    known = device_choices()
    if known is None:
        layout.label(text="Looking for devices", icon="SORTTIME")
        if not bpy.app.timers.is_registered(_show_again):
            bpy.app.timers.register(_show_again, first_interval=_LOOK_SECONDS)
        return
    column = layout.column(align=True)
    column.use_property_split = False
    own = context.scene.raybatch
    if sum(each.name.startswith("cuda") for each in known) < 2:
        column.prop(own, CHOICE, expand=True)
        return
    ticked, there = _ticked(own.device), {each.name for each in known}
    for each in choices_for(own.device):
        row = column.row(align=True)
        row.prop_enum(own, CHOICE, each.name)
        if each.name in there - {"AUTO"}:
            is_ticked = each.name in ticked
            icon = "CHECKBOX_HLT" if is_ticked else "CHECKBOX_DEHLT"
            row.operator("raybatch.share_device", text="", icon=icon, depress=is_ticked).name = each.name


def _show_again() -> float | None:
    """Draw panels again once the devices are known; the seconds until the next look."""
    if device_choices() is None:
        return _LOOK_SECONDS
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()
    return None


def register() -> None:
    """The ticks; `properties` makes the property."""
    bpy.utils.register_class(RAYBATCH_OT_share_device)


def unregister() -> None:
    """The same undone; end the look."""
    bpy.utils.unregister_class(RAYBATCH_OT_share_device)
    if bpy.app.timers.is_registered(_show_again):
        bpy.app.timers.unregister(_show_again)
