"""The settings at `scene.raybatch`, made from the core's definitions, and the passes of RayBatch's own at
`view_layer.raybatch`.
"""

from __future__ import annotations

import contextlib
from fractions import Fraction

import bpy
import numpy as np

from ..core.errors import SettingsError
from ..core.settings.settings import BYTES, SETTINGS, SettingInfo, parse_setting
from ..export.settings import assign_setting
from .choices import chosen_for, statistics_of
from .devices import CHOICE, device_choice_property


def _update_passes(_self, context) -> None:
    # the compositor's Render Layers node gets its socket, or loses it
    if context.view_layer is not None:
        context.view_layer.update_render_passes()


# How Blender shows numbers of a unit
_SUBTYPES = {"pixels": "PIXEL", "of rays alive": "FACTOR"}


def _property(info: SettingInfo):
    """Blender's property for one setting."""
    about = dict(name=info.label, description=_description(info), default=info.default, options=set())
    if info.name == "device":
        # Text, not an enumeration: a file from a machine with other devices keeps what it says, and the render names
        # the devices that there are. The panel shows them by another property, `device_choice`
        return bpy.props.StringProperty(**about)
    if info.choices:
        if info.name == "denoise":  # it asks for a pass
            about["update"] = _update_passes
        return bpy.props.EnumProperty(items=list(info.choices), **about)
    if info.kind is str:
        return bpy.props.StringProperty(**about)
    if info.unit == BYTES:
        # Blender's integers have 32 bits. The number is kept as text, exactly; `megabytes_name` shows it
        about.update(
            default=str(info.default),
            description=f"{about['description']}; 1.5G is 1,500,000,000, and 512Mi is 536,870,912",
        )
        return bpy.props.StringProperty(**about)
    if info.unit in _SUBTYPES:
        about["subtype"] = _SUBTYPES[info.unit]
    minimum, maximum = info.range
    if info.kind is int:
        return bpy.props.IntProperty(min=int(minimum), max=int(maximum), **about)
    if info.unit == "s":
        return bpy.props.FloatProperty(min=minimum, max=maximum, unit="TIME_ABSOLUTE", step=100, **about)
    # the first digit of a relative error that is not 0 is often the third
    precision = {"relMSE": 6, "relative": 4}.get(info.unit, 3)
    return bpy.props.FloatProperty(min=minimum, max=maximum, precision=precision, **about)


def _description(info: SettingInfo) -> str:
    unit = f" [{info.unit}]" if info.unit else ""
    return f"{info.panel_description}{unit}"


def megabytes_name(info: SettingInfo) -> str:
    """The property that shows a number of bytes in megabytes."""
    return f"{info.name}_mb"


def switch_name(info: SettingInfo) -> str:
    """The checkbox of a setting: on or off, automatic or not, limited or not. Empty where it has none."""
    if info.is_switch or info.off is not None:
        return f"{info.name}_is_on"
    return f"{info.name}_is_auto" if info.auto is not None and info.kind is int else ""


def _switch(info: SettingInfo):
    """Blender's property for the checkbox of a setting: a view of the one that keeps it."""

    def get(properties) -> bool:
        value = getattr(properties, info.name)
        if info.is_switch:
            return value == "ON"
        if info.auto is not None:
            return str(value) == str(info.auto)
        # a number of bytes is kept as text
        return str(value) != str(info.off) if info.unit == BYTES else value != info.off

    def put(properties, checked: bool) -> None:
        if info.is_switch:
            setattr(properties, info.name, "ON" if checked else "OFF")
        elif checked != get(properties):
            rests = info.auto if info.auto is not None else info.off
            is_set = checked == (info.auto is None)
            assign_setting(properties, info.name, _first_value(info, properties.id_data) if is_set else rests)

    name, about = info.label, info.panel_description
    if info.is_switch:
        meaning = next(description for identifier, _, description in info.choices if identifier == "ON")
        about = f"{about}.\nOn: {meaning}"
    elif info.auto is not None:
        name, about = "Auto", f"RayBatch chooses. {info.panel_description}"
    return bpy.props.BoolProperty(name=name, description=about, options=set(), get=get, set=put)


def _first_value(info: SettingInfo, scene: bpy.types.Scene) -> int | float:
    """What a number is at first where RayBatch no longer chooses it: what was chosen in the last render, if known."""
    choice = chosen_for(statistics_of(scene), info.name)
    if choice is not None and info.kind is int:
        with contextlib.suppress(SettingsError):
            return parse_setting(info.name, str(choice["value"])) or info.start
    return info.start


def _megabytes(info: SettingInfo):
    """Blender's property for a number of bytes, shown in megabytes: a view of the one that keeps it."""
    minimum, maximum = info.range

    def get(properties) -> float:
        try:
            return parse_setting(info.name, getattr(properties, info.name)) / 1e6
        except SettingsError:  # text that a script put there; the render will say so
            return 0.0

    def put(properties, value: float) -> None:
        # Blender's floats are float32: the shortest decimal that means the same is what was typed
        number = round(Fraction(str(np.float32(value))) * 10**6)
        assign_setting(properties, info.name, min(max(number, int(minimum)), int(maximum)))

    return bpy.props.FloatProperty(
        name=info.label,
        description=f"{info.panel_description} [MB, of 1,000,000 bytes]",
        min=minimum / 1e6,
        max=maximum / 1e6,
        precision=3,
        step=100,
        options=set(),
        get=get,
        set=put,
    )


def _annotations() -> dict:
    properties = {name: _property(info) for name, info in SETTINGS.items()}
    views = {megabytes_name(info): _megabytes(info) for info in SETTINGS.values() if info.unit == BYTES}
    views["version"] = bpy.props.StringProperty(
        name="Version", description="The version of RayBatch that last had these settings", options={"HIDDEN"}
    )
    views[CHOICE] = device_choice_property()
    return properties | views | {switch_name(info): _switch(info) for info in SETTINGS.values() if switch_name(info)}


RayBatchSettings = type(
    "RayBatchSettings",
    (bpy.types.PropertyGroup,),
    {"__doc__": "RayBatch's settings of a scene.", "__annotations__": _annotations()},
)


def _cost_pass(name: str, description: str):
    """Blender's property for a pass that shows cost."""
    description += ": mean over the samples of a pixel. Counters are on for it, and the render takes longer"
    return bpy.props.BoolProperty(
        name=name, description=description, default=False, options=set(), update=_update_passes
    )


class RayBatchViewLayer(bpy.types.PropertyGroup):
    """RayBatch's own passes of a view layer."""

    use_pass_sample_count: bpy.props.BoolProperty(
        name="Sample Count",
        description="Samples that each pixel has. With Adaptive Sampling they differ from pixel to pixel",
        default=False,
        options=set(),
        update=_update_passes,
    )
    use_pass_rays: _cost_pass("Rays", "Rays that a path takes, shadow rays included")
    use_pass_node_steps: _cost_pass("Node Steps", "Nodes of the tree that the rays of a path visit")
    use_pass_triangle_tests: _cost_pass("Triangle Tests", "Triangles that the rays of a path are tested with")
    use_pass_treelet_visits: _cost_pass(
        "Treelet Visits", "Treelets that the rays of a path visit; 0 unless the render batches"
    )
    use_pass_times_queued: _cost_pass(
        "Times Queued", "How often the rays of a path wait in a queue; 0 unless the render batches"
    )


# what they are found at
_groups = (
    (bpy.types.Scene, RayBatchSettings, "Settings of RayBatch"),
    (bpy.types.ViewLayer, RayBatchViewLayer, "Passes of RayBatch's own"),
)


def register() -> None:
    """Add `scene.raybatch` and `view_layer.raybatch`."""
    for owner, group, description in _groups:
        bpy.utils.register_class(group)
        owner.raybatch = bpy.props.PointerProperty(type=group, name="RayBatch", description=description)


def unregister() -> None:
    """Remove both."""
    for owner, group, _ in reversed(_groups):
        del owner.raybatch
        bpy.utils.unregister_class(group)
