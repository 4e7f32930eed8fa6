"""What the preset BALANCED of `core/settings/presets.py` sets."""

import bpy

bpy.ops.raybatch.preset(preset="BALANCED")
