"""Small scenes that have one feature each, for tests that look at all of them: they share their kernels."""

import dataclasses

import numpy as np

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.inputs.ray_inputs import ROUNDED, SAMPLES_SHIFT
from raybatch_addon.core.scene.cameras import CameraKind, Panorama, SphericalStereo
from raybatch_addon.core.scene.description import (
    ALL_LIGHT_SETS,
    ALL_SHADOW_SETS,
    Closure,
    ClosureKind,
    Frame,
    Light,
    LightKind,
    Material,
    Mesh,
    Scene,
    Visibility,
    Volume,
    World,
)
from raybatch_addon.core.scene.linking import catcher_bits, shadow_bit
from raybatch_addon.core.scene.motion import instance_maps
from raybatch_addon.core.scene.passes import CATCHER_PASS, GUIDE_PASSES, LIGHT_GROUP, OCCLUSION_PASS
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes

SETTINGS = RenderSettings(sample_count=1, bounce_max=2, ray_sort="OFF")
CATCHES = int(Visibility.ALL) | catcher_bits(int(Visibility.ALL))
CAUGHT = Frame(32, 32, passes=("Combined", CATCHER_PASS, "Diffuse Direct"), transparent=True)


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
    """All closures of fibres but that of facets."""
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


def seen_by(kind: CameraKind, lens_radius=0.0, stereo=None) -> Scene:
    """A lit scene and the camera of this kind among its objects."""
    scene = lit(shiny())
    window = (-0.5, 0.5, -0.5, 0.5) if kind == CameraKind.PERSPECTIVE else (0.0, 1.0, 0.0, 1.0)
    view = dataclasses.replace(
        scene.camera,
        kind=kind,
        window=window,
        panorama=Panorama(polynomial=(0.0, -0.05, 1e-4, 0.0, 0.0)) if kind.is_panorama else None,
        lens_radius=lens_radius,
        focus_distance=2.0,
        stereo=stereo,
    )
    return dataclasses.replace(scene, camera=view)


def asking(*asked: str) -> Material:
    """A material whose program asks for rays by ops of these names."""
    builder = ProgramBuilder()
    normal = builder.value("normals")[0]
    weight = (0.8, 0.7, 0.6)
    if "bevel" in asked:
        normal = builder.value("bevel", normal, 0.1, ROUNDED | 2 << SAMPLES_SHIFT, -1, -1)
    if "ambient_occlusion" in asked:
        seen = builder.value("ambient_occlusion", normal, 1.0, 3 << SAMPLES_SHIFT, -1, -1)
        weight = builder.value("combine_xyz", seen, seen, 0.5)
    builder.closure("diffuse", weight, normal)
    return Material("asking", kinds=(ClosureKind.DIFFUSE, ClosureKind.OWN_NORMAL), program=builder.finish())


def displacing() -> Material:
    """Moves vertices along their normals, unevenly."""
    builder = ProgramBuilder()
    place = builder.value("object_coordinates", 0)
    builder.closure("vertex_offset", builder.value("multiply_colors", builder.value("normals")[0], place))
    return dataclasses.replace(shiny(), displacement=builder.finish())


def sent_on(with_program: bool) -> Material:
    """Rays go on elsewhere, some straight on."""
    clear = Closure(ClosureKind.TRANSPARENT, (0.3,) * 3)
    if not with_program:
        elsewhere = Closure(ClosureKind.RAY_PORTAL, (0.5,) * 3, edge=(0.0, 0.0, 3.0), tangent=(0.0, 0.6, -0.8))
        return scenes.material(dataclasses.replace(elsewhere, distribution=1), clear)
    builder = ProgramBuilder()
    builder.closure("transparent", (0.3,) * 3)
    place = builder.value("object_coordinates", 0)
    builder.closure("ray_portal", (0.5,) * 3, 1, place, (0.0, 0.6, -0.8))
    builder.closure("diffuse", (0.2,) * 3, builder.value("normals")[0])
    kinds = (ClosureKind.TRANSPARENT, ClosureKind.RAY_PORTAL, ClosureKind.DIFFUSE, ClosureKind.OWN_NORMAL)
    return Material("sent on", kinds=kinds, program=builder.finish())


def sky() -> World:
    """Brighter to one side, by a program; sampled."""
    builder = ProgramBuilder()
    direction = builder.value("normals")[2]
    builder.closure("emission", builder.value("multiply_colors", direction, direction))
    return World(program=builder.finish())


def linked(scene: Scene, lights=False, shadows=False, groups=False) -> Scene:
    """`scene` whose first lamp lights the second object alone, which does not block it; emitters are in groups."""
    instances, lamp = scene.instances, scene.lights[0]
    count = len(instances)
    links = np.zeros((count, 3), np.uint64)
    links[:, 1:] = ALL_LIGHT_SETS, ALL_SHADOW_SETS
    if lights:
        links[1:, 0], lamp = 1, dataclasses.replace(lamp, light_sets=0b10)
        links[-1, 1] = 0b01
    visibility = np.array(instances.visibility, np.int32)
    if shadows:
        visibility |= [shadow_bit(1 if i == 1 else 0) for i in range(count)]
        links[-1, 2], lamp = 0b10, dataclasses.replace(lamp, shadow_sets=0b01)
    placed = dataclasses.replace(instances, links=links, visibility=visibility)
    second = dataclasses.replace(scenes.sun(1.0, 0.2), name="second")
    scene = dataclasses.replace(scene, instances=placed, lights=(lamp, second, *scene.lights[1:]))
    if not groups:
        return scene
    passes = (*scene.frame.passes, f"{LIGHT_GROUP}a", f"{LIGHT_GROUP}b")
    return dataclasses.replace(
        scene,
        frame=dataclasses.replace(scene.frame, passes=passes),
        light_groups=("a", "b"),
        lights=(dataclasses.replace(lamp, light_group=1), *scene.lights[1:]),
        instances=dataclasses.replace(placed, light_group=np.full(count, 1, np.int32)),
        world=dataclasses.replace(scene.world, light_group=0),
    )


def glowing() -> Material:
    """Shines by a program, and scatters."""
    builder = ProgramBuilder()
    builder.closure("emission", builder.value("object_coordinates", 0))
    builder.closure("diffuse", (0.5,) * 3, builder.value("normals")[0])
    return Material(
        "glowing", kinds=(ClosureKind.EMISSION, ClosureKind.DIFFUSE, ClosureKind.OWN_NORMAL), program=builder.finish()
    )


def under_sky(surface=None, portal=False) -> Scene:
    """A lit scene in a world that is sampled, through a portal or not."""
    world = sky()
    if portal:
        above = Light("portal", LightKind.RECTANGLE, scenes.translation(0, 0, 2), (0.0,) * 3, size=(2.0, 2.0))
        world = dataclasses.replace(world, portals=(above,))
    return dataclasses.replace(lit(surface), world=world)


GUIDED = Frame(32, 32, passes=("Combined", *GUIDE_PASSES))
PARTED = ("Depth", "Mist", "CryptoObject00", "Emission", "Environment", "Diffuse Direct", "Diffuse Indirect")
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
    "lifted shadow rays": (scenes.lifted(scenes.mixed(Frame(32, 32))), {}),
    "subsurface": (lit(wax()), {}),
    "subsurface without light": (lit(wax()), {"nee": "OFF"}),
    "lamp program": (lit(lamp=lamp_program()), {}),
    "lamp program behind what is transparent": (lit(veil(), lamp=lamp_program()), {}),
    "transparent with a program": (lit(veil_program()), {}),
    "transparent with a program, without light": (lit(veil_program()), {"nee": "OFF"}),
    "transparent with a program that asks for history": (lit(veil_program(asks_history=True)), {}),
    "camera that moves": (panned(lit()), {}),
    "nothing to hit": (scenes.scene(frame=Frame(32, 32), world=1.0), {}),
    "pixels that end one by one": (lit(), {"adaptive_sampling": "ON", "sample_count": 64}),
    "Warp's tree": (lit(), {"batching": "REFERENCE"}),
    "panorama with a lens, in stereo": (
        seen_by(CameraKind.EQUIRECTANGULAR, 0.05, SphericalStereo(0.03, 2.0, (0.5, 1.2))),
        {},
    ),
    "rays for programs": (lit(asking("bevel", "ambient_occlusion")), {"bounce_max": 3}),
    "displacement": (lit(displacing()), {}),
}
# The same of what is much alike: each by itself
EACH_FEATURE = {
    **{
        kind.name.lower(): (seen_by(kind, 0.05 * (kind % 2)), {})
        for kind in CameraKind
        if kind not in (CameraKind.PERSPECTIVE, CameraKind.ORTHOGRAPHIC)
    },
    "stereo": (seen_by(CameraKind.PERSPECTIVE, 0.0, SphericalStereo(0.03, 2.0)), {}),
    "stereo with a lens": (seen_by(CameraKind.PERSPECTIVE, 0.1, SphericalStereo(0.0, 2.0)), {}),
    "lamp program without a shadow": (lit(lamp=dataclasses.replace(lamp_program(), casts_shadow=False)), {}),
    "occlusion": (lit(asking("ambient_occlusion")), {}),
    "rounded edges": (lit(asking("bevel")), {"bounce_max": 3}),
    "the pass of occlusion": (lit(veil(), Frame(32, 32, passes=("Combined", OCCLUSION_PASS))), {}),
    "the pass of occlusion of programs": (lit(asking("bevel"), Frame(32, 32, passes=("Combined", OCCLUSION_PASS))), {}),
}

# The same of features that wide general kernels have alone; a few that hold all of them, then each by itself
WIDE_FEATURES = {
    "settings of Cycles, and a denoiser's passes": (lit(shiny(), GUIDED), CYCLES_SETTINGS),
    "fibres that move": (moving(furry(hair())), {}),
    "a volume with a program": (filled(fog(), cloud(), lamp=lamp_program()), {}),
    "linked light, groups and a portal": (
        linked(under_sky(glowing(), portal=True), lights=True, shadows=True, groups=True),
        {"bounce_max": 4, "clamp_indirect": 5.0},
    ),
    "sent on elsewhere": (lit(sent_on(with_program=True)), {"bounce_max": 4}),
}
EACH_WIDE_FEATURE = {
    "bounces by kind": (lit(shiny()), {"diffuse_bounce_max": 0}),
    "filter glossy": (lit(shiny()), {"filter_glossy": 1.0}),
    "no caustics": (lit(shiny()), {"caustics_reflective": "OFF", "bounce_max": 4}),
    "a denoiser's passes": (lit(veil(), GUIDED), {}),
    "all passes of a program": (lit(glowing(), Frame(32, 32, passes=(*GUIDED.passes, *PARTED))), {"bounce_max": 3}),
    "toon": (lit(toon()), {}),
    "shadow catchers": (lit(veil(), CAUGHT, CATCHES), {}),
    "a shadow catcher that shines": (lit(glowing(), CAUGHT, CATCHES), {}),
    "fibres": (furry(), {}),
    "moving": (moving(lit()), {}),
    "moving, transparent with a program": (moving(lit(veil_program())), {}),
    "volume": (filled(fog()), {}),
    "volume of the world": (filled(world=fog(0.05)), {}),
    "volume without light": (filled(fog()), {"nee": "OFF"}),
    "linked light": (linked(lit(veil()), lights=True), {}),
    "linked light of surfaces": (linked(lit(glowing()), lights=True), {}),
    "linked shadows": (linked(lit(veil()), shadows=True), {}),
    "linked light that is not sampled": (linked(lit(glowing()), lights=True, shadows=True), {"nee": "OFF"}),
    "groups": (linked(lit(), groups=True), {}),
    "groups behind what is transparent": (linked(lit(veil_program()), groups=True), {}),
    "portal of the world": (under_sky(portal=True), {}),
    "few bounces of lights": (scenes.few_bounces(under_sky(glowing())), {"bounce_max": 3}),
    "the pass Vector of a panorama": (
        dataclasses.replace(seen_by(CameraKind.MIRROR_BALL, 0.0), frame=Frame(32, 32, passes=("Combined", "Vector"))),
        {},
    ),
    "linked volume": (linked(filled(fog(), cloud()), lights=True, shadows=True, groups=True), {}),
    "sent on elsewhere without a program": (lit(sent_on(with_program=False)), {"bounce_max": 4}),
    "sent on elsewhere, a denoiser's passes": (
        dataclasses.replace(lit(frame=GUIDED), materials=(scenes.diffuse(), sent_on(with_program=True))),
        {"bounce_max": 4},
    ),
}
ALL_FEATURES = FEATURES | EACH_FEATURE | WIDE_FEATURES | EACH_WIDE_FEATURE
