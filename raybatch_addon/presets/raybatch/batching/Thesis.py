"""What the preset THESIS of `core/settings/presets.py` sets."""

import bpy

bpy.ops.raybatch.preset(preset="THESIS")
