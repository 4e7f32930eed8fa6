"""What shading kernels read of a scene."""

from __future__ import annotations

import warp as wp

from ..scene.geometry import Geometry
from ..shading.light_table import LightTable
from ..shading.materials import MaterialTable
from ..shading.nodes.op import NodeData


@wp.struct
class SceneData:
    """What shading reads."""

    geometry: Geometry
    materials: MaterialTable
    nodes: NodeData  # of the materials' programs; empty where there are none
    world_nodes: NodeData  # of the world's
    lamp_nodes: NodeData  # of those of lights without mesh
    lights: LightTable
    world: wp.vec3  # radiance of the world [W/(m² sr)]
    world_visibility: int
    view_origin: wp.vec3  # of the camera, for depth
    view_axis: wp.vec3
