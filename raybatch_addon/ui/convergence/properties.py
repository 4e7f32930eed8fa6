"""Properties of a scene that the panel Convergence remembers."""

from __future__ import annotations

import bpy


class RayBatchConvergence(bpy.types.PropertyGroup):
    """Values that the panel Convergence remembers of a scene."""

    record: bpy.props.BoolProperty(
        name="Record Renders",
        default=False,
        options=set(),
        description="Keep rays a second over time of each render. Error over time is kept as well, and without this, "
        "where Error Estimate is on",
    )
    target: bpy.props.FloatProperty(
        name="Error to Reach",
        default=0.001,
        min=1e-9,
        max=1e9,
        precision=6,
        options=set(),
        description="An error (relMSE): how long it takes to reach it is reported; by default Stop at Error, if set",
    )


def chosen_target(scene: bpy.types.Scene) -> float:
    """The relMSE to which the time is stated."""
    return scene.raybatch.error_target or scene.raybatch_convergence.target
