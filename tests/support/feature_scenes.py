"""Small scenes that have one feature each, for tests that look at all of them: they share their kernels."""

import dataclasses

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame, Material, Visibility
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
    "nothing to hit": (scenes.scene(frame=Frame(32, 32), world=1.0), {}),
    "Warp's tree": (lit(), {"batching": "REFERENCE"}),
}
