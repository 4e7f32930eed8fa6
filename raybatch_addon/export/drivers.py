"""Drivers that Blender cannot evaluate: they leave meaningless values in properties, and the user is warned."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ..core.scene.notice import Notice, Weight


def failed_drivers(depsgraph: bpy.types.Depsgraph) -> list[Notice]:
    """One line for each driver, of any datablock of the depsgraph or its nodes, whose expression or variables fail."""
    lines = []
    for datablock in depsgraph.ids:
        if datablock.is_embedded_data:  # reported with the datablock that embeds it
            continue
        label = f"{datablock.bl_rna.name.lower()} “{datablock.name}”"
        for path in _failed(datablock):
            text = (
                f"{label}: the driver of “{path}” cannot be evaluated, so that its value is the last one, or that "
                "without driver; mend its expression and variables in the Drivers Editor"
            )
            lines.append(
                Notice(
                    text, Weight.REPAIRED, objects=[datablock.name] if isinstance(datablock, bpy.types.Object) else []
                )
            )
    return lines


def _failed(datablock: bpy.types.ID) -> Iterator[str]:
    """Paths of properties whose drivers fail, of the datablock and of the node tree that it owns."""
    for owner in (datablock, getattr(datablock, "node_tree", None)):
        data = getattr(owner, "animation_data", None)  # collections and images, among others, have none
        for curve in data.drivers if data else ():
            # muted drivers are not evaluated, and cannot fail
            if not curve.mute and not curve.driver.is_valid:
                yield curve.data_path
