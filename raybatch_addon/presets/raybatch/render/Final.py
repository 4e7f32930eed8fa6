"""What the preset FINAL of `core/settings/presets.py` sets."""

import bpy

bpy.ops.raybatch.preset(preset="FINAL")
