"""Settings of the preset THESIS of `core/settings/presets.py`."""

import bpy

bpy.ops.raybatch.preset(preset="THESIS")
