"""Sky Texture."""

from __future__ import annotations

from ....core.programs.builder import Value
from ....core.scene.description import Image
from ....core.sky.atmosphere import SUN_SIZE_MIN, Atmosphere, sky_table, sun_direction, wrapped_sun
from ....core.sky.hosek_wilkie import hosek_wilkie_table
from ....core.sky.multiple_scattering import MULTIPLE_SCATTERING
from ....core.sky.preetham import preetham_table
from ....core.sky.single_scattering import SINGLE_SCATTERING
from ..node import Node
from ..registry import values
from .mapping import is_unmapped, mapped, texture_coordinates

# Blender before 5.0 has an earlier form of single scattering
_EARLIER = "NISHITA"
_MODELS = {
    "SINGLE_SCATTERING": SINGLE_SCATTERING,
    "MULTIPLE_SCATTERING": MULTIPLE_SCATTERING,
    _EARLIER: SINGLE_SCATTERING,
}


@values("ShaderNodeTexSky", family="Textures")
def sky(node: Node) -> Value:
    """The sky in a direction.

    Without link the direction is that of the ray into the world, and generated coordinates on surfaces.
    """
    settings = node.node
    node.graph.collections.note_lookup()  # its picture is made of the node, and is not found by Blender's images
    # with the sun's disc there is no input, and an old link to it does not count
    shines = settings.sun_disc and settings.sky_type in _MODELS
    direction = mapped(node, node.coordinates()) if shines else texture_coordinates(node)
    if settings.sky_type == "PREETHAM":
        return node.op("sky_preetham", preetham_table(settings.sun_direction, settings.turbidity), direction)
    if settings.sky_type == "HOSEK_WILKIE":
        table = hosek_wilkie_table(settings.sun_direction, settings.turbidity, settings.ground_albedo)
        return node.op("sky_hosek_wilkie", table, direction)
    model = _MODELS[settings.sky_type]
    if settings.sky_type == _EARLIER:
        node.warn("the sky of Blender 5.2 (single scattering) takes the place of that")
        aerosol = settings.dust_density
    else:
        aerosol = settings.aerosol_density
    elevation, azimuth = wrapped_sun(settings.sun_elevation, settings.sun_rotation)
    atmosphere = Atmosphere(elevation, settings.altitude, settings.air_density, aerosol, settings.ozone_density)
    size = max(settings.sun_size, SUN_SIZE_MIN)
    table = sky_table(
        model.sun_disc(atmosphere, size) if shines else None,
        elevation,
        azimuth,
        size,
        settings.sun_intensity,
        settings.altitude,
    )
    if shines and type(node.graph.owner).__name__ == "World":
        toward = sun_direction(elevation, azimuth) if is_unmapped(node) else None
        node.graph.collections.suns.add((toward, size))
    key = (settings.sky_type, atmosphere)
    picture = node.graph.collections.image(
        key, lambda: Image(f"sky of {node.node.name}", model.sky_picture(atmosphere))
    )
    return node.op("sky_scattering", picture, table, direction)
