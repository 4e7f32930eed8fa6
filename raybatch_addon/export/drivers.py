"""Drivers that Blender cannot evaluate: what they drive keeps a value of no meaning, which the user is told."""

from __future__ import annotations

from collections.abc import Iterator

import bpy


def failed_drivers(depsgraph: bpy.types.Depsgraph) -> list[str]:
    """One line a driver, of any datablock of the depsgraph or its nodes, whose expression or variables fail."""
    lines = []
    for datablock in depsgraph.ids:
        if datablock.is_embedded_data:  # told with what it is embedded in
            continue
        label = f"{datablock.bl_rna.name.lower()} “{datablock.name}”"
        for path in _failed(datablock):
            lines.append(
                f"{label}: the driver of “{path}” cannot be evaluated, so that its value is the last one, or that without driver; "
                "mend its expression and variables in the Drivers Editor"
            )
    return lines


def _failed(datablock: bpy.types.ID) -> Iterator[str]:
    """Paths of properties whose drivers fail, of the datablock and of the node tree that it owns."""
    for owner in (datablock, getattr(datablock, "node_tree", None)):
        data = getattr(owner, "animation_data", None)  # collections and images, among others, have none
        for curve in data.drivers if data else ():
            # what is muted is not evaluated, and fails nobody
            if not curve.mute and not curve.driver.is_valid:
                yield curve.data_path
