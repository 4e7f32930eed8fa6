"""Settings of the preset AUTO of `core/settings/presets.py`."""

import bpy

bpy.ops.raybatch.preset(preset="AUTO")
