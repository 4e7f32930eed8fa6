"""The scene as the core receives it: NumPy arrays and plain dataclasses, no Blender, no device.

Units: lengths in metres (Blender units), angles in radians, light in Blender's radiometric RGB.
Axes are Blender's world axes. A camera looks along its own -Z, with +X right and +Y up.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, Field, dataclass, field
from enum import IntEnum, IntFlag

import numpy as np

# the archive finds all classes here
from .cameras import Camera, CameraKind, Frame, Panorama, Shutter, SphericalStereo  # noqa: F401
from .program import Image, ImageEncoding, Instruction, Program, ProgramFeatures  # noqa: F401

_STORED_NAME = "stored_name"  # metadata of a field that is called otherwise in files


def stored_name(of: Field) -> str:
    """Name of a dataclass's field in saved scenes and in digests, which stays when the field is renamed."""
    return of.metadata.get(_STORED_NAME, of.name)


class Visibility(IntFlag):
    """Kinds of rays that see an object; rays whose bit an object lacks skip it."""

    CAMERA = 1
    DIFFUSE = 2
    GLOSSY = 4
    TRANSMISSION = 8
    SHADOW = 16
    VOLUME_SCATTER = 32
    ALL = 63


# Rays that surfaces scatter
SCATTERED_RAYS = int(Visibility.DIFFUSE | Visibility.GLOSSY | Visibility.TRANSMISSION)

# Light linking: emitters light the receivers of some sets of objects, and the objects of some sets block their light.
# Bits of all sets; a number of bits that are in sets is an unsigned integer
LIGHT_SETS, SHADOW_SETS = 64, 20
COPY_SET = LIGHT_SETS - 1  # of paths that see shadow catchers alone
ALL_LIGHT_SETS, ALL_SHADOW_SETS = (1 << LIGHT_SETS) - 1, (1 << SHADOW_SETS) - 1
SHADOW_SET_SHIFT = 6  # in visibilities the bits of shadow sets lie from here on
# and behind them those of `Visibility` again, of shadow catchers alone: for rays that see nothing else. Volumes scatter
# none of these
CATCHER_RAYS = int(Visibility.ALL & ~Visibility.VOLUME_SCATTER)
CATCHER_SHIFT = SHADOW_SET_SHIFT + SHADOW_SETS


class ClosureKind(IntEnum):
    """Scattering and emission models that a material mixes (see `shading/bsdf/bsdf.py`), and abilities of closures.

    Facets are of GGX where a closure does not say otherwise.
    """

    DIFFUSE = 0  # Lambert
    # Lambert below a dielectric coat (roughness, ior): scaled by the share of light that the coat lets through
    LAYERED_DIFFUSE = 1
    GLOSSY = 2  # facets that reflect all light
    METAL = 3  # facets with the Fresnel of F82-tint: `color` at normal incidence, Schlick's times `edge` at 82 degrees
    DIELECTRIC = 4  # facets of a dielectric coat, Fresnel from `ior`
    GLASS = 5  # facets that reflect and refract, Fresnel from `ior`
    TRANSPARENT = 6  # passes straight on, times `weight`
    EMISSION = 7  # emits `weight` as radiance on both sides
    ROUGH_DIFFUSE = 8  # Oren and Nayar's, `roughness`; each bounce between its grooves is multiplied by `color`
    TRANSLUCENT = 9  # Lambert on the other side
    REFRACTION = 10  # facets that refract all light except total reflection
    CONDUCTOR = 11  # facets with the Fresnel of a conductor: `color` is its index, `edge` its extinction coefficient
    ASHIKHMIN_SHIRLEY = 12  # anisotropic Phong lobe
    SHEEN = 13  # a layer of fibres
    VELVET = 14  # Ashikhmin's; `roughness` is sigma
    HOLDOUT = 15  # hole in the picture: takes light, and `weight` of it takes the film's alpha
    SHEET = 16  # facets that scatter to the other side as GLOSSY's do to this one: a rough sheet without thickness
    SUBSURFACE = 17  # light goes in and scatters below: a random walk through the medium (`shading/bsdf/subsurface.py`)
    # a cone of light with an edge (`shading/bsdf/drawn/toon.py`); `distribution` 0: on the normal, 1: where it mirrors
    TOON = 20
    # rays that meet it go on elsewhere: from `edge` [m] where `distribution` is 1, along `tangent` where that is not 0
    RAY_PORTAL = 21
    # Fibres (`shading/hair`): `tangent` is their direction
    HAIR_REFLECTION = 24  # `roughness` along the fibre and `aspect` around it [rad]; `film_ior` is the shift [rad]
    HAIR_TRANSMISSION = 25
    PRINCIPLED_HAIR = 26  # what its fields mean `shading/hair/chiang.py` says
    FACET_HAIR = 27  # and of this `shading/hair/huang.py`
    # Abilities: not models, but needed by closures whose values ask for them (`Closure.needs`)
    BECKMANN = 32  # `distribution` 1
    ANISOTROPIC = 33  # `aspect` other than 1
    THIN_FILM = 35  # `film_thickness`
    OWN_NORMAL = 34  # `normal`
    # Closures of volumes (`Volume`), beside EMISSION: weights are coefficients [1/m]
    VOLUME_ABSORPTION = 48
    HENYEY_GREENSTEIN = 49  # scattering of mean cosine `mean_cosine`
    FOURNIER_FORAND = 50  # scattering by particles in water: `ior`, and `roughness`, the share that goes back
    DRAINE = 51  # scattering by dust: `mean_cosine`, and `aspect`, the factor of the squared cosine
    RAYLEIGH = 52  # scattering by what is smaller than the wavelength

    @property
    def is_model(self) -> bool:
        """Whether closures can be of this kind."""
        return self < ClosureKind.BECKMANN

    @property
    def is_hair(self) -> bool:
        """Whether closures of this kind are fibres."""
        return ClosureKind.HAIR_REFLECTION <= self <= ClosureKind.FACET_HAIR


class LightKind(IntEnum):
    """Kinds of lights without mesh."""

    POINT = 0
    SPOT = 1
    SUN = 2
    RECTANGLE = 3
    ELLIPSE = 4


@dataclass(frozen=True)
class Attribute:
    """Numbers across a mesh that shader programs read; see `Scene.attributes`."""

    kind: str
    name: str
    # float32; one value for each corner, shape [triangle_count, 3, width], or each triangle, shape [triangle_count,
    # width]. The width is 1 for a number, 2 for a pair, 3 for a vector, 4 for a colour with alpha
    values: np.ndarray


@dataclass(frozen=True)
class Grid:
    """Values on a regular grid, linear between its points, which programs of volumes read by name; 0 outside."""

    name: str
    values: np.ndarray  # float32, shape [x, y, z], or [x, y, z, 3]; of tiles [n, 8, 8, 8], or [n, 8, 8, 8, 3]
    to_index: np.ndarray  # object space to indices of voxels, float64, shape [3, 4]
    corners: np.ndarray | None = None  # indices of the first voxels of tiles, multiples of 8, int32, shape [n, 3]


@dataclass(frozen=True)
class Mesh:
    """Triangles in object space, shared by any number of instances; or segments of curves, or points."""

    name: str
    positions: np.ndarray  # [m], float32, shape [vertex_count, 3]
    triangles: np.ndarray  # vertex indices, int32, shape [triangle_count, 3]
    triangle_slot: np.ndarray | None = None  # material slot, int32, shape [triangle_count]; None: slot 0 everywhere
    _: KW_ONLY
    corner_normals: np.ndarray | None = None  # unit, float32, shape [triangle_count, 3, 3]; None: flat
    corner_uvs: np.ndarray | None = None  # float32, shape [triangle_count, 3, 2]; None: no UV map
    # centre and half size of the box that generated texture coordinates span, in object space [m]; None: -1..1
    texture_space: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    attributes: tuple[Attribute, ...] = ()  # values that programs of its materials read
    # `positions` at evenly spaced times while the shutter is open, float32, shape [steps, vertex_count, 3]; meshes that
    # have some have as many steps. None: it does not deform
    motion: np.ndarray | None = None
    motion_normals: np.ndarray | None = None  # `corner_normals` at these times, float32, shape [steps, n, 3, 3]
    # `positions` a frame before and a frame after, for the pass Vector; float32, shape [2, vertex_count, 3]
    frames: np.ndarray | None = None
    # Radius of each vertex [m], float32, shape [vertex_count]: in place of triangles there are segments of curves,
    # whose ends are the first two vertices of each row of `triangles`. The third is the first again, also in what
    # corners have. A segment that begins where the row before ends goes on from there; one without length is a sphere.
    # None: triangles
    radii: np.ndarray | None = None
    ribbons: bool = False  # with `radii`: segments are strips that face each ray, instead of round
    # triangles that are flat beside others that are not: they stay so when vertices move. Bool, shape [triangle_count];
    # None: no triangle is, or all are
    flat: np.ndarray | None = None
    # where the vertices were before a render moved them (core/displacement), which generated coordinates are of; None:
    # nothing did
    base_positions: np.ndarray | None = None
    grids: tuple[Grid, ...] = ()  # values that the programs of its volumes read
    object_density: bool = False  # coefficients of its volumes are those of object space, not of the world [1/m]
    # how far what fills the mesh moves while the shutter is open, in object space [m]: vectors; None: it does not
    flow: Grid | None = None
    flow_time: float = 0.5  # when all is where `grids` and `flow` have it; 0 to 1 while the shutter is open


@dataclass(frozen=True)
class Closure:
    """One weighted closure of a material; fields that its kind does not use are ignored."""

    kind: ClosureKind
    weight: tuple[float, float, float]  # linear RGB, >= 0: colour times mix factors (EMISSION: radiance, W/(m² sr))
    roughness: float = 0.0  # Blender's roughness, 0..1; the facets' alpha is its square
    ior: float = 1.5  # index of the inside relative to the outside (GLASS, DIELECTRIC, LAYERED_DIFFUSE)
    _: KW_ONLY
    # METAL: tint at 82 degrees; DIELECTRIC, GLASS: tint at normal incidence; CONDUCTOR: extinction coefficient
    edge: tuple[float, float, float] = (1.0, 1.0, 1.0)
    # GLASS: refracted light is multiplied by `weight` times this, reflected light by `weight`
    refraction: tuple[float, float, float] = (1.0, 1.0, 1.0)
    share: float = 1.0  # the mix factors that `weight` contains; used where `color` is None
    multiscatter: bool = True  # GLOSSY to GLASS, LAYERED_DIFFUSE: add light that bounces more than once between facets
    # Colour of a facet without mix factors. GLOSSY, GLASS, ROUGH_DIFFUSE: multiplies light that bounces between
    # facets; METAL: reflectance at normal incidence; CONDUCTOR: index of refraction. None: the colour of `weight`,
    # without the factors in `share`; METAL, CONDUCTOR: `weight` / `share`, and the closure's weight is `share`
    color: tuple[float, float, float] | None = field(default=None, metadata={_STORED_NAME: "colour"})
    distribution: int = 0  # facets: 0 GGX, 1 Beckmann
    aspect: float = 1.0  # facets: alpha along the tangent is multiplied by it, across it divided
    normal: tuple[float, float, float] = (0.0, 0.0, 0.0)  # in world space; 0: the surface's
    tangent: tuple[float, float, float] = (0.0, 0.0, 0.0)  # in world space; 0: facets are isotropic
    # METAL, CONDUCTOR, DIELECTRIC, GLASS: thickness of a film on the facets [nm]; below 0.1 there is none
    film_thickness: float = 0.0
    film_ior: float = 1.33  # index of the film, relative to the outside
    # SUBSURFACE: mean cosine of the phase function. `color` is the medium's albedo, `edge` its extinction [1/m],
    # `refraction` a factor of a walk's throughput at its start; `multiscatter`: half of the light goes in diffusely
    mean_cosine: float = 0.0

    @property
    def needs(self) -> frozenset[ClosureKind]:
        """The kind, and the abilities that the values ask for."""
        abilities = {
            ClosureKind.DIFFUSE: self.kind == ClosureKind.SUBSURFACE,  # light comes out again by Lambert's law
            ClosureKind.BECKMANN: self.distribution == 1
            and self.kind not in (ClosureKind.TOON, ClosureKind.RAY_PORTAL),
            ClosureKind.ANISOTROPIC: self.aspect != 1 and any(self.tangent) and not self.kind.is_hair,
            ClosureKind.THIN_FILM: self.film_thickness > 0,
            ClosureKind.OWN_NORMAL: any(self.normal),
        }
        return frozenset([self.kind, *(kind for kind, there in abilities.items() if there)])


@dataclass(frozen=True)
class Volume:
    """A medium that fills closed surfaces, or the world: a sum of closures of the kinds of volumes and of EMISSION.

    Weights are coefficients: of scattering and absorption [1/m], of emission [W/(m³ sr)]. What fills a surface adds to
    what is around it.
    """

    closures: tuple[Closure, ...] = ()
    program: Program | None = None  # makes the closures at every point, instead of `closures`


@dataclass(frozen=True)
class Material:
    """A named sum of closures; with no closure it is black."""

    name: str
    closures: tuple[Closure, ...] = ()  # closures with a weight above 0
    # Kinds that the material's nodes can have when a slider moves (by node kind, not by value). Kernels are compiled
    # for these, so that few sliders compile anything. Includes the kinds of `closures`, and OWN_NORMAL where
    # `program` gives a closure a normal other than 0, which kernels without it ignore.
    kinds: tuple[ClosureKind, ...] = ()
    program: Program | None = None  # makes the closures at every point, instead of `closures`
    _: KW_ONLY
    index: int = 0  # what the pass Material Index shows
    displacement: Program | None = None  # moves vertices (op `vertex_offset`)
    displacement_bends: bool = False  # `program` bends the normals of surfaces by the displacement too
    volume: Volume | None = None  # what fills the surfaces of this material; None: nothing
    aimed: bool = True  # light is aimed at what emits; else rays that meet it by chance find all of its light
    shadow_opaque: bool = False  # shadow rays end here, whatever of the surface is transparent


@dataclass(frozen=True)
class InstanceMaps:
    """Object to world of the instances that move, at several times."""

    instance: np.ndarray  # which they are, ascending, int32, shape [m]
    maps: np.ndarray  # float32, shape [m, times, 3, 4]


@dataclass(frozen=True)
class Instances:
    """Placements of meshes, one entry for each instance."""

    mesh: np.ndarray  # index into `Scene.meshes`, int32, shape [n]
    transform: np.ndarray  # object to world, float32, shape [n, 3, 4]
    slot_first: np.ndarray  # first entry of the instance in `Scene.slot_materials`, int32, shape [n]
    # `Visibility` bits, int32, shape [n]; where light is linked to blockers also the bit of the instance's shadow set,
    # from `SHADOW_SET_SHIFT` on, if shadow rays see it; of a shadow catcher the first again, from `CATCHER_SHIFT` on
    visibility: np.ndarray
    object: np.ndarray  # index into `Scene.object_names`, int32, shape [n]
    _: KW_ONLY
    # values that shader programs read: red, green, blue, alpha of the object's colour, its index, and a random number;
    # float32, shape [n, 6]
    info: np.ndarray | None = None
    # RGBA attributes of objects, and of objects that place them, which programs read by index; float32, shape [n, k, 4]
    attributes: np.ndarray | None = None
    motion: InstanceMaps | None = None  # at evenly spaced times while the shutter is open; None: none moves
    # the number of the light set that the instance is lit as, and bits of the light sets that its own light falls on
    # and of the shadow sets that block it; uint64, shape [n, 3]. None: set 0, and all sets
    links: np.ndarray | None = None
    frames: InstanceMaps | None = None  # a frame before and a frame after, for the pass Vector; None: none moves
    light_group: np.ndarray | None = None  # index into `Scene.light_groups`, int32, shape [n]; -1, or None: no group
    terminator: np.ndarray | None = None  # `terminator_lift`'s cutoff, 0..1, float32, shape [n]; 0, or None: none

    def __len__(self) -> int:
        return len(self.mesh)

    @staticmethod
    def empty() -> Instances:
        """Arrays without instances."""
        none = np.zeros(0, np.int32)
        return Instances(none, np.zeros((0, 3, 4), np.float32), none, none, none)


@dataclass(frozen=True)
class Light:
    """A light without mesh, which shines along its own -Z (SPOT, SUN, RECTANGLE, ELLIPSE)."""

    name: str
    kind: LightKind
    transform: np.ndarray  # light to world, orthonormal axes in the columns, float32, shape [3, 4]
    # POINT, SPOT: radiant intensity (on the axis, before blending) [W/sr]; SUN: irradiance of a
    # surface that faces it [W/m²]; RECTANGLE, ELLIPSE: radiosity / pi, the radiance where `spread` is pi [W/(m² sr)]
    emission: tuple[float, float, float]
    _: KW_ONLY
    radius: float = 0.0  # POINT, SPOT: radius of the luminous sphere [m]
    soft_falloff: bool = True  # POINT, SPOT: the light is a disk that faces the shaded point, else a sphere
    angle: float = 0.0  # SUN: angular diameter [rad]; SPOT: full cone angle [rad]
    blend: float = 0.0  # SPOT: share of the cone that is softened, 0..1
    spot_scale: tuple[float, float] = (1.0, 1.0)  # SPOT: width of the cone along x and y relative to z
    size: tuple[float, float] = (1.0, 1.0)  # RECTANGLE, ELLIPSE: full width along x and y [m]
    spread: float = np.pi  # RECTANGLE, ELLIPSE: full angle into which light leaves [rad]
    visibility: int = int(Visibility.ALL)  # kinds of rays that meet the light itself
    casts_shadow: bool = True
    # the sum of its emission closures multiplies `emission`, in every direction and at every point of the light's
    # shape; None: factor 1
    program: Program | None = None
    # values of the light's object that the program reads: its map to the world with all scale and shear, float32,
    # shape [3, 4] (None: `transform`), and a row as in `Instances.info`
    object_transform: np.ndarray | None = None
    info: tuple[float, ...] | None = None
    attributes: np.ndarray | None = None  # a row as in `Instances.attributes`; float32, shape [k, 4]
    light_sets: int = ALL_LIGHT_SETS  # bits of the light sets that it lights
    shadow_sets: int = ALL_SHADOW_SETS  # bits of the shadow sets that block its light
    light_group: int = -1  # index into `Scene.light_groups`; -1: no group
    bounce_max: int | None = None  # most bounces of paths from which it is aimed at; None: all


@dataclass(frozen=True)
class SkySun:
    """A disc in the sky, part of what the world's program shows: directions are chosen within it."""

    direction: tuple[float, float, float]  # unit vector towards its middle
    size: float  # angular diameter [rad], above 0 and at most pi


@dataclass(frozen=True)
class World:
    """Light that comes to rays which leave the scene."""

    radiance: tuple[float, float, float] = (0.0, 0.0, 0.0)  # linear RGB [W/(m² sr)]
    visibility: int = int(Visibility.ALL)
    # the sum of its emission closures is the radiance of every direction, instead of `radiance`
    program: Program | None = None
    sampling_size: int = 1024  # texels around the world, by whose brightness a program is sampled; 0: it is not sampled
    _: KW_ONLY
    sun: SkySun | None = None  # of `program`, too small for these texels
    volume: Volume | None = None  # what fills all space; None: nothing
    light_group: int = -1  # index into `Scene.light_groups`; -1: no group
    # RECTANGLE, ELLIPSE: openings by which the light of `program` comes to where they shine; they give none themselves
    portals: tuple[Light, ...] = ()
    casts_shadow: bool = True  # False: where the world is aimed at, nothing is in the way
    bounce_max: int | None = None  # as that of a `Light`, where it is sampled


@dataclass(frozen=True)
class Scene:
    """All data of one picture."""

    camera: Camera
    frame: Frame
    meshes: tuple[Mesh, ...] = ()
    instances: Instances = field(default_factory=Instances.empty)
    _: KW_ONLY
    # material index by slot; an instance's slot s is `slot_materials[slot_first + s]`. int32, shape [k]
    slot_materials: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    materials: tuple[Material, ...] = ()
    images: tuple[Image, ...] = ()
    # kind and name of the attributes of meshes that programs read by index
    attributes: tuple[tuple[str, str], ...] = ()
    lights: tuple[Light, ...] = ()
    world: World = World()
    object_names: tuple[str, ...] = ()
    light_groups: tuple[str, ...] = ()  # names of groups of emitters, which have passes of their own
    asset_names: tuple[str, ...] = ()  # for each object: the name of its topmost parent; empty: objects have none
    # messages about objects that were skipped, repaired or replaced by the export, by name
    warnings: tuple[str, ...] = ()

    @property
    def triangles_placed(self) -> int:
        """Triangles as they are placed: those of a mesh count once for each of its instances."""
        sizes = np.array([len(mesh.triangles) for mesh in self.meshes], np.int64)
        return int((sizes * np.bincount(self.instances.mesh, minlength=len(sizes))).sum())
