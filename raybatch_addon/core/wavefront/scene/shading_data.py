"""The data of a scene that shading kernels read."""

from __future__ import annotations

import warp as wp

from ...programs.op import NodeData
from ...scene.geometry import Geometry
from ...shading.bsdf.materials import MaterialTable
from ...shading.images.textures import ImageTable
from ...shading.lights.table import LightTable


@wp.struct
class SceneData:
    """The data that shading reads."""

    geometry: Geometry
    materials: MaterialTable
    nodes: NodeData  # of the materials' programs; empty where there are none
    world_nodes: NodeData  # of the world's
    lamp_nodes: NodeData  # of those of lights without mesh
    lights: LightTable
    world: wp.vec3  # radiance of the world [W/(m² sr)]
    world_visibility: int
    view_origin: wp.vec3  # of the camera, for depth
    view_axis: wp.vec3  # unit; 0 where depth is the distance from the camera


def with_images(nodes: NodeData, images: ImageTable) -> NodeData:
    """`nodes` whose ops look up `images`."""
    made = _copied(nodes)
    made.images = images
    return made


def with_surface_images(data: SceneData, images: ImageTable) -> SceneData:
    """`data` in which the materials' programs look up `images`."""
    made = _copied(data)
    made.nodes = with_images(data.nodes, images)
    return made


def _copied(value):
    made = value._cls()
    for name in value._cls.vars:
        setattr(made, name, getattr(value, name))
    return made


@wp.func
def depth_of(data: SceneData, position: wp.vec3) -> float:
    """How deep in the picture a point is [m]: along the view axis, or from the camera where that has none."""
    seen = position - data.view_origin
    if wp.dot(data.view_axis, data.view_axis) == 0.0:
        return wp.length(seen)
    return wp.dot(seen, data.view_axis)
