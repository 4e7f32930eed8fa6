"""Settings of the preset FINAL of `core/settings/presets.py`."""

import bpy

bpy.ops.raybatch.preset(preset="FINAL")
