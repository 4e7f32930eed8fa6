"""Settings of the preset PREVIEW of `core/settings/presets.py`."""

import bpy

bpy.ops.raybatch.preset(preset="PREVIEW")
