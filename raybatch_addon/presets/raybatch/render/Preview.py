"""What the preset PREVIEW of `core/settings/presets.py` sets."""

import bpy

bpy.ops.raybatch.preset(preset="PREVIEW")
