"""Panoramic cameras, their lenses and their stereo eyes."""

from __future__ import annotations

import math

import bpy

from tests.blender.features.build import ball, look, shaded, world_graph
from tests.blender.features.registry import feature

_BALLS = (
    ((0, 2, 0), 0.5, (0.9, 0.3, 0.1)),
    ((1.5, 0.6, 0.4), 0.4, (0.1, 0.8, 0.2)),
    ((-1.2, 1.2, -0.6), 0.3, (0.2, 0.3, 0.9)),
    ((0.3, -2, 0.8), 0.6, (0.8, 0.8, 0.2)),
    ((0.2, 0.4, 1.6), 0.4, (0.1, 0.7, 0.8)),
    ((-0.3, 0.5, -1.4), 0.4, (0.7, 0.2, 0.7)),
)


def surroundings(scene: bpy.types.Scene) -> bpy.types.Camera:
    """Balls that shine on all sides of the camera, before a sky that is another colour in every direction."""

    def sky(graph):
        direction = graph.value("ShaderNodeTexCoord", output="Generated")
        return graph.value(
            "ShaderNodeBackground", {"Color": graph.vector_math("MULTIPLY_ADD", direction, (0.3,) * 3, (0.4,) * 3)}
        )

    world_graph(scene, sky)
    for position, radius, color in _BALLS:
        made = ball("Ball", position, radius, smooth=False)
        shaded(made, "ShaderNodeEmission", Color=(*color, 1), Strength=1.0)
    look(scene, (0.1, -0.2, 0.1), (0.1, 1, 0.2))
    scene.camera.rotation_euler.rotate_axis("Z", 0.2)
    scene.render.resolution_y = scene.render.resolution_x * 3 // 4
    return scene.camera.data


def _panorama(name: str, kind: str, samples: int = 64, more=None, quick: bool = False, **values) -> None:
    @feature(f"Camera: {name}", "Surface", "picture", samples=samples, quick=quick)
    def build(scene: bpy.types.Scene) -> None:
        camera = surroundings(scene)
        camera.type = "PANO"
        settings = camera if hasattr(camera, "panorama_type") else camera.cycles
        settings.panorama_type = kind
        for key, value in values.items():
            setattr(settings if hasattr(settings, key) else camera, key, value)
        if more:
            more(camera)


def _lens(camera: bpy.types.Camera) -> None:
    camera.dof.use_dof, camera.dof.focus_distance, camera.dof.aperture_fstop = True, 1.5, 0.1
    camera.dof.aperture_blades, camera.dof.aperture_rotation, camera.dof.aperture_ratio = 3, 0.3, 1.5


_panorama("equirectangular", "EQUIRECTANGULAR", quick=True)
_panorama(
    "equirectangular, a part",
    "EQUIRECTANGULAR",
    longitude_min=-1.0,
    longitude_max=1.4,
    latitude_min=-0.5,
    latitude_max=1.2,
    shift_x=0.1,
    shift_y=-0.05,
)
_panorama("equirectangular, depth of field", "EQUIRECTANGULAR", 512, _lens)
_panorama("mirror ball, depth of field", "MIRRORBALL", 512, _lens)
_panorama("equiangular cube map face", "EQUIANGULAR_CUBEMAP_FACE")
_panorama("mirror ball", "MIRRORBALL")
_panorama("fisheye, equidistant", "FISHEYE_EQUIDISTANT", quick=True, fisheye_fov=4.0)
_panorama("fisheye, equisolid", "FISHEYE_EQUISOLID", fisheye_fov=math.pi, fisheye_lens=10.5, sensor_width=36.0)
_panorama(
    "fisheye, equisolid, vertical fit", "FISHEYE_EQUISOLID", fisheye_fov=2.0, sensor_fit="VERTICAL", sensor_height=20.0
)
_panorama("fisheye, lens polynomial", "FISHEYE_LENS_POLYNOMIAL", fisheye_fov=3.2, fisheye_polynomial_k1=-0.09)
_panorama(
    "central cylindrical",
    "CENTRAL_CYLINDRICAL",
    central_cylindrical_range_u_min=-2.5,
    central_cylindrical_range_u_max=2.0,
    central_cylindrical_range_v_min=-1.0,
    central_cylindrical_range_v_max=2.0,
    central_cylindrical_radius=1.5,
)
