"""What the preset UNBATCHED of `core/settings/presets.py` sets."""

import bpy

bpy.ops.raybatch.preset(preset="UNBATCHED")
