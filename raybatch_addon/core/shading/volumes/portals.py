"""Ray portals in scenes with volumes, found before a render."""

from __future__ import annotations

from ...scene.description import ClosureKind, Material, Scene
from ...scene.notice import Notice, quoted


def portals_in_volumes(scene: Scene) -> list[Notice]:
    """A notice where rays may come out of a portal into volumes of objects, or be in some where they go in; or none.

    The world's volume is the same on both sides.
    """
    portals = [material.name for material in scene.materials if _is_portal(material)]
    if not portals or all(material.volume is None for material in scene.materials):
        return []
    text = (
        "Ray Portal: a ray that comes out of one is in the volumes of the place where it went in "
        f"(material {quoted(portals)})"
    )
    remedy = "keep volumes away from both ends of portals"
    return [Notice(text, material=portals[0] if len(portals) == 1 else "", remedy=remedy)]


def _is_portal(material: Material) -> bool:
    kinds = {*material.kinds, *(closure.kind for closure in material.closures)}
    return ClosureKind.RAY_PORTAL in kinds
