"""Save the file of this version: python -m tests.blender.versions.save, in the repository

Each version has one, made once, before it is released: `VERSION.blend`, and in `VERSION.json` what it means.
"""

import dataclasses
import json
from pathlib import Path

import bpy

FOLDER = Path(__file__).parent

# Where the rule below would choose what does not go together, or what a later version is to mend
CHOSEN = {"batching": "ON", "warp_count": 1, "device": "cuda"}


def unlike_default(info):
    """A legal value other than the default."""
    if info.name in CHOSEN:
        return CHOSEN[info.name]
    if info.choices:
        return next(name for name, _, _ in reversed(info.choices) if name != info.default)
    if info.kind is str:
        return "somewhere"
    if info.kind is float:
        return info.default / 2 + 0.0625
    if info.name == "texture_tile_size":  # a power of two
        return 2 * info.default
    if info.default == info.maximum:
        return 7
    return min(info.default + (1 if info.minimum == 1 else 64), int(info.maximum))


def groups_of(scene):
    """The groups of properties of ours in a file but for the settings, by name."""
    own = {name: getattr(scene, name) for name in scene.bl_rna.properties.keys() if name.startswith("raybatch_")}
    return own | {"view_layer": scene.view_layers[0].raybatch}


def kept_properties(group):
    """The properties of a group that a file keeps."""
    return [prop for prop in group.bl_rna.properties if prop.identifier not in ("rna_type", "name")]


def values_of(group):
    """By name; fractions as text that means them."""
    found = {prop.identifier: getattr(group, prop.identifier) for prop in kept_properties(group)}
    return {name: f"{value:.7g}" if isinstance(value, float) else value for name, value in found.items()}


def change(group) -> None:
    """Give each property of a group a legal value other than its default."""
    for prop in kept_properties(group):
        if prop.type == "BOOLEAN":
            value = not prop.default
        elif prop.type == "ENUM":
            value = next(item.identifier for item in reversed(prop.enum_items) if item.identifier != prop.default)
        else:
            value = type(prop.default)(prop.default / 2 + 1 if prop.default > 2 else prop.default * 2)
        setattr(group, prop.identifier, value)


def save(version: str, settings, assign, settings_from) -> None:
    """Write both files."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "RAYBATCH"
    for name, info in settings.items():
        assign(scene.raybatch, name, unlike_default(info))
    for group in groups_of(scene).values():
        change(group)
    scene.view_layers[0].raybatch.use_pass_node_steps = False
    meant = dataclasses.asdict(settings_from(scene))
    meant["groups"] = {name: values_of(group) for name, group in groups_of(scene).items()}
    (FOLDER / f"{version}.json").write_text(json.dumps(meant, indent=1) + "\n", encoding="utf-8")
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / f"{version}.blend"), compress=True)


if __name__ == "__main__":
    import raybatch_addon
    from raybatch_addon.core.settings.settings import SETTINGS
    from raybatch_addon.core.version import VERSION
    from raybatch_addon.export.settings import assign_setting, settings_from

    raybatch_addon.register()
    save(VERSION, SETTINGS, assign_setting, settings_from)
