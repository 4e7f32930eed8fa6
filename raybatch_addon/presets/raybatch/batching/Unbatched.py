"""Settings of the preset UNBATCHED of `core/settings/presets.py`."""

import bpy

bpy.ops.raybatch.preset(preset="UNBATCHED")
