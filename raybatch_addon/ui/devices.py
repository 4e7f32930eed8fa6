"""The list of devices in the panel Device: a button for each, with its name and memory."""

from __future__ import annotations

import bpy

from ..blender.devices import DeviceChoice, device_choices

CHOICE = "device_choice"  # the property: a view of `device`, which is text, as devices differ from computer to computer
_LOOK_SECONDS = 0.2
_shown: list[tuple[str, str, str, str, int]] = []  # Blender does not keep the texts of an enumeration's items


def choices_for(value: str) -> list[DeviceChoice]:
    """The devices that there are, and `value` if it is none of them."""
    found = list(device_choices() or ())
    if value.lower() not in (each.name.lower() for each in found):
        text = f"{value}: not on this computer" if found else "Looking for devices"
        found.append(DeviceChoice(value, text, "Choose one of the others"))
    return found


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
    if device_choices() is None:
        layout.label(text="Looking for devices", icon="SORTTIME")
        if not bpy.app.timers.is_registered(_show_again):
            bpy.app.timers.register(_show_again, first_interval=_LOOK_SECONDS)
        return
    column = layout.column(align=True)
    column.use_property_split = False
    column.prop(context.scene.raybatch, CHOICE, expand=True)


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
    """Nothing: `properties` makes the property."""


def unregister() -> None:
    """End the look."""
    if bpy.app.timers.is_registered(_show_again):
        bpy.app.timers.unregister(_show_again)
