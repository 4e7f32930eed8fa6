"""Particle hair: radii along its strands, its children, and how they are bent."""

import bpy

from tests.blender.features.build import add_world, floor, lamp, look, material_graph
from tests.blender.features.registry import feature
from tests.support.blender_builders import add_grid


def _diffuse(color):
    return lambda graph: graph.value("ShaderNodeBsdfDiffuse", {"Color": color})


def fur(scene: bpy.types.Scene, count: int = 40, length: float = 1.0) -> bpy.types.ParticleSettings:
    """Hair on a square above a floor, that of the first material; its settings."""
    scene.cycles_curves.shape = "THICK_LINEAR"  # which both engines render most nearly alike
    add_world(scene, 0.5, (0.6, 0.75, 1.0))
    lamp("SUN", (0, 0, 5), target=(2, 3, 0), energy=2.0, angle=0.1)
    floor()
    look(scene, (0, -4.5, 2.2), (0, 0, 0.7), lens=50)
    ground = add_grid("Emitter", 4)
    ground.location.z = 0.02
    material_graph(ground, _diffuse((0.3, 0.6, 0.2, 1.0)))
    ground.modifiers.new("Hair", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length = "HAIR", count, length
    settings.root_radius, settings.tip_radius, settings.radius_scale = 1.0, 0.2, 0.1
    settings.use_close_tip = False
    return settings


def _hair(name: str, count: int = 40, quick: bool = False, length: float = 1.0, **values) -> None:
    """Register a picture of hair whose settings have `values`."""

    @feature(f"Particle hair: {name}", "Curves", "picture", quick=quick)
    def build(scene: bpy.types.Scene) -> None:
        settings = fur(scene, count, length)
        for key, value in values.items():
            setattr(settings, key, value)


_hair("tips that are closed", use_close_tip=True, tip_radius=0.6)
_hair("tips thicker than roots", quick=True, root_radius=0.2, tip_radius=1.0)
_hair("no radius at the root", root_radius=0.0, tip_radius=0.8)
_hair("strand shape above 0", shape=0.7)
_hair("strand shape below 0, tips that are closed", quick=True, shape=-0.7, use_close_tip=True)
_CHILDREN = {"child_type": "INTERPOLATED", "rendered_child_count": 6}
_hair("interpolated children", 60, quick=True, **_CHILDREN)
_hair("interpolated children, clumped and rough", 60, **_CHILDREN, clump_factor=0.8, roughness_1=0.1, roughness_2=0.2)
_hair("children and their parents", child_type="SIMPLE", rendered_child_count=4, use_parent_particles=True)
for _kink in ("CURL", "RADIAL", "WAVE", "BRAID", "SPIRAL"):
    _hair(
        f"kink {_kink.lower()}",
        20,
        quick=_kink == "SPIRAL",
        child_type="SIMPLE",
        rendered_child_count=4,
        kink=_kink,
        kink_amplitude=0.15,
        kink_frequency=2.0,
        render_step=6,
    )
