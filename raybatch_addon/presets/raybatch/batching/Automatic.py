"""What the preset AUTO of `core/settings/presets.py` sets."""

import bpy

bpy.ops.raybatch.preset(preset="AUTO")
