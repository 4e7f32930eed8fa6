"""Features of a scene: they decide what is compiled, allocated, uploaded and launched for it.

Pure functions derive `SceneFeatures` from the scene and the settings. Materials count by the kinds that their nodes can
have, not by the values of their sockets, so that most sliders compile nothing; docs/architecture.md lists those that
do, while general kernels render. Each kernel is specialised on the few of these features that concern it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..settings.settings import RenderSettings
from .description import CameraKind, ClosureKind, LightKind, Scene, Visibility, Volume
from .linking import (
    RAY_BITS,
    can_be_met,
    catchers,
    lifts_shadow_rays,
    light_rays,
    limits_bounces,
    links_lights,
    links_shadows,
)
from .motion import apart
from .passes import (
    COST_PASSES,
    OCCLUSION_PASS,
    PASSES,
    SAMPLE_COUNT,
    VECTOR,
    guides_denoising,
    light_group_passes,
    records_surfaces,
    shows_catchers,
    splits_light,
)
from .program import ProgramFeatures, program_features

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")
# Kinds that scatter; the others emit or let light pass
SCATTERING = tuple(k for k in ClosureKind if k not in (ClosureKind.EMISSION, ClosureKind.TRANSPARENT))

# Ops that ask how a path came to a point
PATH_HISTORY_OPS = frozenset(("path_history", "portal_depth"))
# Ops by which a point of a volume may differ with the way that a ray came there
_OPS_OF_WAYS = PATH_HISTORY_OPS | {"light_path", "ray_length"}
# Facets through which a transparent film shows, where it is asked for
SEEN_THROUGH = frozenset((ClosureKind.GLASS, ClosureKind.REFRACTION, ClosureKind.SHEET))
# Passes that are no features of a scene: that which every film has, and those that counters fill
_PASSES_OF_OTHERS = ("Combined", *COST_PASSES, SAMPLE_COUNT)


@dataclass(frozen=True, kw_only=True)
class SceneFeatures:
    """Features that kernels are specialised on."""

    closures: tuple[ClosureKind, ...] = ()  # sorted
    closure_count: int = 0  # most closures of a material without program
    programs: ProgramFeatures = ProgramFeatures()  # needs of the materials' shader graphs
    world_program: ProgramFeatures = ProgramFeatures()
    lamp_program: ProgramFeatures = ProgramFeatures()  # needs of the shader graphs of lights without mesh
    lights: tuple[LightKind, ...] = ()  # sorted
    light_sphere: bool = False  # a point or spot light shaped as a sphere
    light_hits: bool = False  # a light without mesh that rays can meet
    light_choice: bool = False  # there may be several emitters to choose among
    mesh_lights: bool = False  # materials emit
    mesh_programs: bool = False  # materials emit by a program
    world_light: bool = False  # the world's radiance varies, and is sampled
    light_portals: bool = False  # it is sampled through portals
    volume_lights: bool = False  # volumes that emit are emitters
    world: bool = False  # rays that leave the scene find light
    camera: CameraKind = CameraKind.PERSPECTIVE
    depth_of_field: bool = False
    spherical_stereo: bool = False
    camera_motion: bool = False  # the camera moves while its shutter is open
    moving: bool = False  # instances or vertices do
    surfaces: bool = False  # there is something to hit
    instancing: bool = False  # more than one mesh tree: instances or objects hidden from some rays
    smooth_normals: bool = False
    terminator: bool = False  # shadow rays begin above the faces of some smooth meshes
    curves: bool = False  # some primitives are segments of curves, or points
    film_transparent: bool = False
    film_glass: bool = False  # a transparent film shows through glass
    passes: tuple[str, ...] = ("Combined",)
    panorama_vectors: bool = False  # the pass Vector is that of a panorama
    sample_sequence: str = "SOBOL"
    nee: str = "ON"
    mis: bool = True  # light sampling and BSDF sampling are combined
    clamping: bool = False
    roulette: bool = True
    adaptive: bool = False  # pixels end their sampling one by one
    bounces_by_kind: bool = False  # diffuse, glossy or transmitted bounces have a limit of their own
    filter_glossy: bool = False
    caustics_reflective: bool = True
    caustics_refractive: bool = True
    light_links: bool = False  # some emitters light some objects alone
    shadow_links: bool = False  # the light of some emitters is blocked by some objects alone
    light_bounces: bool = False  # some emitters are aimed at from the first vertices of paths alone
    catchers: bool = False  # some surfaces are shadow catchers, and passes show what they catch
    volumes: bool = False  # something fills surfaces or the world
    volume_program: ProgramFeatures = ProgramFeatures()  # needs of the shader graphs of volumes
    request_program: ProgramFeatures = ProgramFeatures()  # needs of the parts of materials that ask for rays
    fetch_program: ProgramFeatures = ProgramFeatures()  # needs of the parts of materials that ask for tiles of images

    @property
    def transparency(self) -> bool:
        """Whether rays pass straight through some surfaces."""
        return ClosureKind.TRANSPARENT in self.closures

    @property
    def subsurface(self) -> bool:
        """Whether light scatters below some surfaces."""
        return ClosureKind.SUBSURFACE in self.closures

    @property
    def motion(self) -> bool:
        """Whether the time at which a path is traced matters."""
        return self.camera_motion or self.moving or self.volume_program.flows

    @property
    def shadow_rays(self) -> bool:
        """Whether there are lights to aim at, and the settings ask for it."""
        lit = self.surfaces or self.volumes
        emitters = bool(self.lights) or self.mesh_lights or self.world_light or self.volume_lights
        return self.nee != "OFF" and lit and emitters

    @property
    def light_programs(self) -> bool:
        """Whether light that is aimed at may come from programs."""
        return self.shadow_rays and (self.mesh_programs or self.world_light or bool(self.lamp_program))

    @property
    def all_ops(self) -> tuple[str, ...]:
        """Names of the ops of all programs."""
        return self.programs.ops + self.world_program.ops + self.lamp_program.ops

    @property
    def path_history(self) -> bool:
        """Whether programs ask how a path has scattered so far, or limits of bounces do."""
        return self.bounces_by_kind or not PATH_HISTORY_OPS.isdisjoint(self.programs.ops)

    @property
    def requests(self) -> bool:
        """Whether materials ask for rays."""
        return bool(self.request_program)

    @property
    def occlusion_pass(self) -> bool:
        """Whether the film has the pass Ambient Occlusion, of surfaces."""
        return self.surfaces and OCCLUSION_PASS in self.passes

    @property
    def least_density(self) -> bool:
        """Whether it matters how widely a path has scattered."""
        return self.filter_glossy or "bevel" in self.programs.ops

    @property
    def texture_levels(self) -> bool:
        """Whether images are filtered over the footprints of paths."""
        return "image_level" in self.programs.ops

    @property
    def lamp_programs(self) -> bool:
        """Whether lights without mesh have programs."""
        return bool(self.lamp_program)

    @property
    def film_holes(self) -> bool:
        """Whether surfaces cut holes into a film that has alpha."""
        return self.film_transparent and ClosureKind.HOLDOUT in self.closures

    @property
    def normal_pass(self) -> bool:
        """Whether the film has the pass Normal."""
        return "Normal" in self.passes

    @property
    def records_surfaces(self) -> bool:
        """Whether passes show what the first surfaces of paths are, or those behind transparent ones."""
        shown_behind = self.transparency and not {"Depth", "Position", "Normal"}.isdisjoint(self.passes)
        return shown_behind or records_surfaces(self.passes)

    @property
    def guides(self) -> bool:
        """Whether the film has passes that guide a denoiser."""
        return guides_denoising(self.passes)

    @property
    def light_groups(self) -> bool:
        """Whether the film has passes of the light of groups of emitters."""
        return bool(light_group_passes(self.passes))

    @property
    def splits_light(self) -> bool:
        """Whether light is divided among passes."""
        return splits_light(self.passes)

    def left_out(self) -> list[str]:
        """Names of features that this render does without."""
        of_surfaces = [kind for kind in ClosureKind if kind < ClosureKind.VOLUME_ABSORPTION]
        names = {f"closure {kind.name.lower()}": kind in self.closures for kind in of_surfaces}
        names |= {f"light {kind.name.lower()}": kind in self.lights for kind in LightKind}
        names |= {f"pass {name}": name in self.passes for name in PASSES if name not in _PASSES_OF_OTHERS}
        names |= {
            "shader programs": bool(self.programs),
            "world program": bool(self.world_program),
            "programs of lights": bool(self.lamp_program),
            "image textures": any(name.startswith(("image", "environment", "tiled_image")) for name in self.all_ops),
            "levels of images": self.texture_levels,
            "sampling of the world": self.world_light,
            "portals of the world": self.light_portals,
            "volumes as lights": self.volume_lights,
            "emission by programs": self.mesh_programs,
            "shadow rays": self.shadow_rays,
            "lights met by rays": self.light_hits,
            "mesh lights": self.mesh_lights,
            "choice among emitters": self.light_choice,
            "world": self.world,
            "depth of field": self.depth_of_field,
            "spherical stereo": self.spherical_stereo,
            "motion of the camera": self.camera_motion,
            "motion of objects": self.moving,
            "surfaces": self.surfaces,
            "instancing": self.instancing,
            "lifts of shadow rays": self.terminator,
            "smooth normals": self.smooth_normals,
            "curves": self.curves,
            "transparent film": self.film_transparent,
            "transparent film through glass": self.film_glass,
            "clamping": self.clamping,
            "Russian roulette": self.roulette,
            "adaptive sampling": self.adaptive,
            "bounces by kind": self.bounces_by_kind,
            "filtered glossy": self.filter_glossy,
            "light linking": self.light_links,
            "shadow linking": self.shadow_links,
            "bounces of lights": self.light_bounces,
            "vectors of panoramas": self.panorama_vectors,
            "light groups": self.light_groups,
            "shadow catchers": self.catchers,
            "volumes": self.volumes,
            "programs of volumes": bool(self.volume_program),
            "motion within volumes": self.volume_program.flows,
            "rays for programs": self.requests,
            "images in tiles": bool(self.fetch_program),
        }
        return sorted(name for name, there in names.items() if not there)


def derive_features(scene: Scene, settings: RenderSettings) -> SceneFeatures:
    """The features of `scene` rendered with `settings`."""
    used_meshes = np.flatnonzero(np.bincount(scene.instances.mesh))
    surfaces = any(len(scene.meshes[i].triangles) for i in used_meshes)
    kinds: set[ClosureKind] = set()
    if surfaces:
        for material in scene.materials:
            kinds.update(material.kinds)
            for closure in material.closures:
                kinds.update(closure.needs)
    if ClosureKind.RAY_PORTAL in kinds:
        kinds.add(ClosureKind.TRANSPARENT)  # paths go on as behind a transparent surface
    volumes = scene_volumes(scene)
    if volumes:
        kinds.add(ClosureKind.TRANSPARENT)  # shadow rays go from surface to surface
    world, is_sampled = scene.world, (surfaces or bool(volumes)) and settings.nee != "OFF"
    # what no ray sees that surfaces or volumes scatter lights nothing
    lights = bool(int(world.visibility) & light_rays(volumes))
    world_light = is_sampled and lights and world.program is not None and world.sampling_size > 0
    volume_lights = is_sampled and surfaces and _has_volume_lights(scene)
    return SceneFeatures(
        closures=tuple(sorted(kinds)),
        closure_count=max((len(material.closures) for material in scene.materials), default=0) if surfaces else 0,
        programs=_material_programs(scene) if surfaces else ProgramFeatures(),
        request_program=program_features(m.program.requests for m in scene.materials if surfaces and m.program),
        fetch_program=program_features(m.program.fetches for m in scene.materials if surfaces and m.program),
        world_program=program_features([scene.world.program]),
        lamp_program=program_features([light.program for light in scene.lights]),
        lights=tuple(sorted({light.kind for light in scene.lights})),
        light_sphere=any(
            light.kind in (LightKind.POINT, LightKind.SPOT) and not light.soft_falloff and light.radius > 0
            for light in scene.lights
        ),
        light_hits=any(can_be_met(light) for light in scene.lights),
        light_choice=is_sampled
        and (
            ClosureKind.EMISSION in kinds or len(scene.lights) + world_light > 1 or links_lights(scene) or volume_lights
        ),
        mesh_lights=ClosureKind.EMISSION in kinds,
        mesh_programs=surfaces
        and any(m.program is not None and ClosureKind.EMISSION in m.kinds for m in scene.materials),
        world_light=world_light,
        light_portals=world_light and bool(world.portals),
        volume_lights=volume_lights,
        world=any(scene.world.radiance) or scene.world.program is not None,
        camera=scene.camera.kind,
        depth_of_field=scene.camera.lens_radius > 0,
        spherical_stereo=scene.camera.stereo is not None and scene.camera.kind != CameraKind.ORTHOGRAPHIC,
        camera_motion=scene.camera.motion is not None or scene.camera.window_motion is not None,
        moving=surfaces and bool(apart(scene).any()),
        surfaces=surfaces,
        instancing=surfaces and needs_instancing(scene),
        smooth_normals=any(scene.meshes[i].corner_normals is not None for i in used_meshes),
        terminator=is_sampled and surfaces and lifts_shadow_rays(scene),
        curves=any(scene.meshes[i].radii is not None and len(scene.meshes[i].triangles) > 0 for i in used_meshes),
        film_transparent=scene.frame.transparent,
        film_glass=surfaces
        and scene.frame.transparent
        and scene.frame.glass_roughness is not None
        and not SEEN_THROUGH.isdisjoint(kinds),
        passes=tuple(scene.frame.passes),
        panorama_vectors=VECTOR in scene.frame.passes and scene.camera.kind.is_panorama,
        sample_sequence=settings.sample_sequence,
        nee=settings.nee,
        mis=settings.is_on("mis") or settings.nee == "OFF",
        clamping=settings.clamp_direct > 0 or settings.clamp_indirect > 0,
        roulette=settings.roulette_bounce <= settings.bounce_max,
        adaptive=settings.is_adaptive,
        bounces_by_kind=settings.counts_bounces_by_kind,
        filter_glossy=settings.filter_glossy > 0,
        caustics_reflective=settings.is_on("caustics_reflective"),
        caustics_refractive=settings.is_on("caustics_refractive"),
        light_links=links_lights(scene),
        shadow_links=is_sampled and links_shadows(scene),
        light_bounces=is_sampled and limits_bounces(scene, settings.bounce_max, world_light),
        catchers=surfaces and shows_catchers(scene.frame.passes) and bool(catchers(scene).any()),
        volumes=bool(volumes),
        volume_program=_volume_programs(scene, volumes),
    )


def scene_volumes(scene: Scene) -> list[Volume]:
    """What fills the surfaces of `scene`, in the order of its materials, and last what fills the world."""
    of_materials = [material.volume for material in scene.materials]
    return [volume for volume in (*of_materials, scene.world.volume) if volume is not None]


def emits_somewhere(volume: Volume) -> bool:
    """Whether `volume` may emit."""
    if volume.program is None:
        return any(closure.kind == ClosureKind.EMISSION for closure in volume.closures)
    return volume.program.may_emit


def is_emissive(volume: Volume) -> bool:
    """Whether points of `volume` may be aimed at for their light: it emits, the same for all kinds of rays."""
    steps = () if volume.program is None else volume.program.instructions
    return emits_somewhere(volume) and _OPS_OF_WAYS.isdisjoint(step.op for step in steps)


def _has_volume_lights(scene: Scene) -> bool:
    world = scene.world.volume
    if world is not None and emits_somewhere(world):  # all others lie in it
        return False
    return any(material.volume is not None and is_emissive(material.volume) for material in scene.materials)


def _material_programs(scene: Scene) -> ProgramFeatures:
    return program_features(
        [material.program for material in scene.materials],
        max((len(material.closures) for material in scene.materials), default=0),
    )


def _volume_programs(scene: Scene, volumes: list[Volume]) -> ProgramFeatures:
    needs = program_features(
        [volume.program for volume in volumes], max((len(volume.closures) for volume in volumes), default=0)
    )
    return replace(needs, flows=bool(needs) and any(mesh.flow is not None for mesh in scene.meshes))


def needs_instancing(scene: Scene) -> bool:
    """Whether rays need a tree over several mesh trees: a mesh used twice, or objects that some rays do not see."""
    instances = scene.instances
    counts = np.bincount(instances.mesh, minlength=len(scene.meshes))
    filled = np.array([len(mesh.triangles) > 0 for mesh in scene.meshes], bool)
    shared = bool(np.any(filled & (counts > 1)))
    seen = instances.visibility[filled[instances.mesh]] & RAY_BITS
    return shared or bool(apart(scene).any()) or bool(np.any(seen != int(Visibility.ALL)))


def narrow(features: object, kind: type[T]) -> T:
    """The part of `features` that `kind`, a dataclass, has: its fields are fields or properties of `features`."""
    return kind(**{field.name: getattr(features, field.name) for field in dataclasses.fields(kind)})
