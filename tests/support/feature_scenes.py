"""Small scenes that have one feature each, for tests that look at all of them: they share their kernels."""

import dataclasses

import numpy as np

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Material, Mesh, Scene, Visibility, Volume
from raybatch_addon.core.scene.motion import instance_maps
from raybatch_addon.core.scene.passes import GUIDE_PASSES
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

SETTINGS = RenderSettings(sample_count=1, bounce_max=2, ray_sort="OFF")


def lit(surface=None, frame=None, visibility=int(Visibility.ALL), lamp=None):
    surface = surface or scenes.diffuse()
    objects = [
        (scenes.plane(size=4), scenes.translation(0, 0, -1), surface),
        (scenes.sphere(), scenes.IDENTITY, surface, visibility),
    ]
    return scenes.scene(objects, frame=frame or Frame(32, 32), lights=[lamp or scenes.area_light(3.0)], world=0.2)


def veil():
    return scenes.material(Closure(ClosureKind.TRANSPARENT, (0.5,) * 3), Closure(ClosureKind.DIFFUSE, (0.4,) * 3))


def lamp_program():
    """An area light whose program says how bright it is."""
    builder = ProgramBuilder()
    builder.closure("emission", builder.value("object_coordinates", 0))
    return dataclasses.replace(scenes.area_light(3.0), program=builder.finish())


def veil_program(asks_history=False):
    """Light that passes straight on, as much as a program says, which may ask how paths came there."""
    builder = ProgramBuilder()
    asked = (
        builder.value("path_history")[3]
        if asks_history
        else builder.value("average", builder.value("object_coordinates", 0))
    )
    builder.closure("transparent", builder.value("combine_xyz", asked, asked, asked))
    return dataclasses.replace(
        scenes.diffuse(), closures=(), program=builder.finish(), kinds=(ClosureKind.TRANSPARENT,)
    )


# Translucent, with a rough boundary
MEDIUM = Closure(
    ClosureKind.SUBSURFACE,
    (0.8, 0.6, 0.4),
    0.3,
    1.4,
    color=(0.98, 0.9, 0.7),
    edge=(3.0, 6.0, 9.0),
    refraction=(1.2, 1.5, 2.0),
    mean_cosine=0.4,
)


def wax():
    return Material("wax", (MEDIUM,), (ClosureKind.SUBSURFACE, ClosureKind.DIFFUSE))


def unlit(frame=None):
    return scenes.scene([(scenes.sphere(), scenes.IDENTITY, scenes.diffuse())], frame=frame or Frame(32, 32), world=1.0)


def shiny():
    """Facets, sharp and not, over something diffuse."""
    return scenes.material(
        Closure(ClosureKind.GLOSSY, (0.3,) * 3, roughness=0.02),
        Closure(ClosureKind.GLASS, (0.3,) * 3, roughness=0.3, ior=1.4),
        Closure(ClosureKind.DIFFUSE, (0.3,) * 3),
    )


def toon():
    return scenes.material(
        Closure(ClosureKind.TOON, (0.4,) * 3, 0.5, mean_cosine=0.3),
        Closure(ClosureKind.TOON, (0.4,) * 3, 0.3, mean_cosine=0.2, distribution=1),
    )


def hair() -> Material:
    """All closures of fibres."""
    program = ProgramBuilder()
    place = program.value("separate_xyz", program.value("object_coordinates", 0))
    grey = program.value("combine_xyz", program.value("math", 2, False, place[0], place[0], 0.0), 0.4, 0.4)
    program.closure("principled_hair", (0.3,) * 3, grey, 0.3, 0.3, 0.0, 1.55, 0.03)
    program.closure("hair_reflection", (0.3,) * 3, 0.2, 0.3, 0.05, (0.0, 0.0, 0.0))
    program.closure("hair_transmission", (0.3,) * 3, 0.2, 0.3, 0.05, (0.0, 0.0, 0.0))
    kinds = (ClosureKind.HAIR_REFLECTION, ClosureKind.HAIR_TRANSMISSION, ClosureKind.PRINCIPLED_HAIR)
    return Material("hair", kinds=kinds, program=program.finish())


def strands() -> Mesh:
    """Straight fibres that stand on a plane."""
    x, y = np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-0.8, 0.8, 9))
    roots = np.stack([x.ravel(), y.ravel(), np.full(x.size, -1.0)], 1)
    points = np.stack([roots, roots * (1.1, 1.1, -0.5)], 1).astype(np.float32)
    first = 2 * np.arange(len(points), dtype=np.int32)
    rows = np.stack([first, first + 1, first], 1)
    return Mesh("strands", points.reshape(-1, 3), rows, radii=np.full(2 * len(points), 0.03, np.float32))


def furry(surface=None) -> Scene:
    """Fibres on a plane, lit."""
    objects = [
        (scenes.plane(size=4), scenes.translation(0, 0, -1), scenes.diffuse()),
        (strands(), scenes.IDENTITY, surface or scenes.diffuse()),
    ]
    return scenes.scene(objects, lights=[scenes.area_light(3.0)], world=0.2)


def moving(scene: Scene) -> Scene:
    """`scene` with a second object that moves while the shutter is open, and a camera that does."""
    maps = np.repeat(scene.instances.transform[:, None].astype(np.float32), 3, 1)
    maps[1, :, 0, 3] += (-0.3, 0.0, 0.4)
    view = np.repeat(np.asarray(scene.camera.transform, np.float32)[None], 3, 0)
    view[:, 2, 3] += (-0.1, 0.0, 0.1)
    return dataclasses.replace(
        scene,
        instances=dataclasses.replace(scene.instances, motion=instance_maps(maps), transform=maps[:, 1]),
        camera=dataclasses.replace(scene.camera, motion=view),
    )


def panned(scene: Scene) -> Scene:
    """`scene` with a camera that moves, and nothing else."""
    return dataclasses.replace(scene, camera=moving(scene).camera)


def fog(density=0.4) -> Volume:
    """The same everywhere."""
    return Volume(
        (
            Closure(ClosureKind.HENYEY_GREENSTEIN, (density,) * 3, mean_cosine=0.3),
            Closure(ClosureKind.VOLUME_ABSORPTION, (0.1, 0.2, 0.3)),
        )
    )


def cloud() -> Volume:
    """Thicker upwards, and it shines."""
    builder = ProgramBuilder()
    height = builder.value("separate_xyz", builder.value("position", 0))[2]
    raised = builder.value("math", 0, False, height, 1.0, 0.0)
    builder.closure("volume_henyey_greenstein", builder.value("splat", raised), 0.2)
    builder.closure("emission", (0.05, 0.1, 0.2))
    return Volume(program=builder.finish())


def filled(*volumes: Volume, world: Volume | None = None, lamp=None) -> Scene:
    """Boxes of `volumes` over a plane, lit."""
    clear = Closure(ClosureKind.TRANSPARENT, (1.0,) * 3)
    objects = [(scenes.plane(size=4), scenes.translation(0, 0, -1.2), scenes.diffuse())]
    for number, volume in enumerate(volumes):
        surface = Material("filled", (clear,), (ClosureKind.TRANSPARENT,), volume=volume)
        place = scenes.translation(0.7 * number, 0.2 * number, 0.3 * number)  # no faces coincide
        objects.append((scenes.box(size=1.5), place, surface))
    made = scenes.scene(objects, lights=[lamp or scenes.area_light(3.0)], world=0.2)
    return dataclasses.replace(made, world=dataclasses.replace(made.world, volume=world))


GUIDED = Frame(32, 32, passes=("Combined", *GUIDE_PASSES))
CYCLES_SETTINGS = {
    "diffuse_bounce_max": 1,
    "glossy_bounce_max": 1,
    "filter_glossy": 1.0,
    "caustics_reflective": "OFF",
    "caustics_refractive": "OFF",
    "bounce_max": 4,
}

# Scene and changes of `SETTINGS`, by the name of the feature
FEATURES = {
    "opaque, lit": (lit(), {}),
    "no light to aim at": (unlit(), {}),
    "no light is sampled": (lit(), {"nee": "OFF"}),
    "transparent": (lit(veil()), {}),
    "transparent without light": (lit(veil()), {"nee": "OFF"}),
    "hidden from some rays": (lit(visibility=int(Visibility.ALL & ~Visibility.SHADOW)), {}),
    "passes": (lit(frame=Frame(32, 32, passes=("Combined", "Normal", "Depth"), transparent=True)), {}),
    "everything": (scenes.mixed(Frame(32, 32, passes=("Combined", "Normal"), transparent=True)), {}),
    "subsurface": (lit(wax()), {}),
    "subsurface without light": (lit(wax()), {"nee": "OFF"}),
    "lamp program": (lit(lamp=lamp_program()), {}),
    "lamp program behind what is transparent": (lit(veil(), lamp=lamp_program()), {}),
    "transparent with a program": (lit(veil_program()), {}),
    "transparent with a program, without light": (lit(veil_program()), {"nee": "OFF"}),
    "transparent with a program that asks for history": (lit(veil_program(asks_history=True)), {}),
    "camera that moves": (panned(lit()), {}),
    "nothing to hit": (scenes.scene(frame=Frame(32, 32), world=1.0), {}),
    "Warp's tree": (lit(), {"batching": "REFERENCE"}),
}

# The same of features that wide general kernels have alone; a few that hold all of them, then each by itself
WIDE_FEATURES = {
    "settings of Cycles, and a denoiser's passes": (lit(shiny(), GUIDED), CYCLES_SETTINGS),
    "fibres that move": (moving(furry(hair())), {}),
    "a volume with a program": (filled(fog(), cloud(), lamp=lamp_program()), {}),
}
EACH_WIDE_FEATURE = {
    "bounces by kind": (lit(shiny()), {"diffuse_bounce_max": 0}),
    "filter glossy": (lit(shiny()), {"filter_glossy": 1.0}),
    "no caustics": (lit(shiny()), {"caustics_reflective": "OFF", "bounce_max": 4}),
    "a denoiser's passes": (lit(veil(), GUIDED), {}),
    "toon": (lit(toon()), {}),
    "fibres": (furry(), {}),
    "moving": (moving(lit()), {}),
    "moving, transparent with a program": (moving(lit(veil_program())), {}),
    "volume": (filled(fog()), {}),
    "volume of the world": (filled(world=fog(0.05)), {}),
    "volume without light": (filled(fog()), {"nee": "OFF"}),
}
