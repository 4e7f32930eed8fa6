"""Settings of the preset BALANCED of `core/settings/presets.py`."""

import bpy

bpy.ops.raybatch.preset(preset="BALANCED")
