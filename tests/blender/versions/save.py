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
    if info.default == info.maximum:
        return 7
    return min(info.default + (1 if info.minimum == 1 else 64), int(info.maximum))


def save(version: str, settings, assign, settings_from) -> None:
    """Write both files."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "RAYBATCH"
    for name, info in settings.items():
        assign(scene.raybatch, name, unlike_default(info))
    for name in ("use_pass_rays", "use_pass_sample_count"):
        setattr(scene.view_layers[0].raybatch, name, True)
    scene.raybatch_export.exposure, scene.raybatch_viewport.samples = 2.0, 33
    meant = dataclasses.asdict(settings_from(scene))
    (FOLDER / f"{version}.json").write_text(json.dumps(meant, indent=1) + "\n", encoding="utf-8")
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / f"{version}.blend"), compress=True)


if __name__ == "__main__":
    import raybatch_addon
    from raybatch_addon.core.settings.settings import SETTINGS
    from raybatch_addon.core.version import VERSION
    from raybatch_addon.export.settings import assign_setting, settings_from

    raybatch_addon.register()
    save(VERSION, SETTINGS, assign_setting, settings_from)
