"""Passes that Blender's properties ask for.

It imports nothing of the core: the engine is registered with it.
"""

from __future__ import annotations

import bpy

# Passes that can be rendered, by the property of a view layer that asks for them
PASS_PROPERTIES = {"use_pass_z": "Depth", "use_pass_position": "Position", "use_pass_normal": "Normal"}
# Passes that show cost, by the property of a view layer's `raybatch`
COST_PASS_PROPERTIES = {
    "use_pass_rays": "Rays",
    "use_pass_node_steps": "Node Steps",
    "use_pass_triangle_tests": "Triangle Tests",
    "use_pass_treelet_visits": "Treelet Visits",
    "use_pass_times_queued": "Times Queued",
}
# Every pass by a property of a view layer's `raybatch`
OWN_PASS_PROPERTIES = {"use_pass_sample_count": "Sample Count"} | COST_PASS_PROPERTIES


def wanted_passes(view_layer: bpy.types.ViewLayer) -> tuple[str, ...]:
    """Names of the passes that are rendered for `view_layer`."""
    own = getattr(view_layer, "raybatch", None)  # missing while the add-on is not registered
    passes = [name for prop, name in PASS_PROPERTIES.items() if getattr(view_layer, prop)]
    return ("Combined", *passes, *(name for prop, name in OWN_PASS_PROPERTIES.items() if getattr(own, prop, False)))
