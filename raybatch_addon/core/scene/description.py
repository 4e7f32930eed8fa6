"""The scene as the core receives it: NumPy arrays and plain dataclasses, no Blender, no device.

Units: lengths in metres (Blender units), angles in radians, light in Blender's radiometric RGB.
Axes are Blender's world axes. A camera looks along its own -Z, with +X right and +Y up.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum, IntFlag

import numpy as np

from .program import Instruction, Program, ProgramFeatures  # noqa: F401  (the archive finds its classes here)


class Visibility(IntFlag):
    """Kinds of rays that see an object; an object is skipped by rays whose bit it lacks."""

    CAMERA = 1
    DIFFUSE = 2
    GLOSSY = 4
    TRANSMISSION = 8
    SHADOW = 16
    ALL = 31


class ClosureKind(IntEnum):
    """The scattering and emission models that a material mixes (see `shading/closures.py`), and what they may have besides.

    Facets are of GGX where a closure does not say otherwise.
    """

    DIFFUSE = 0  # Lambert
    LAYERED_DIFFUSE = 1  # Lambert below a dielectric coat (roughness, ior): scaled by what the coat lets through
    GLOSSY = 2  # facets that reflect all light
    METAL = 3  # facets with the Fresnel of F82-tint: `colour` at normal incidence, Schlick's times `edge` at 82 degrees
    DIELECTRIC = 4  # facets of a dielectric coat, Fresnel from `ior`
    GLASS = 5  # facets that reflect and refract, Fresnel from `ior`
    TRANSPARENT = 6  # passes straight on, times `weight`
    EMISSION = 7  # emits `weight` as radiance on both sides
    ROUGH_DIFFUSE = 8  # Oren and Nayar's, `roughness`; `colour` is what each bounce between its grooves keeps
    TRANSLUCENT = 9  # Lambert on the other side
    REFRACTION = 10  # facets that refract all light but what they mirror totally
    CONDUCTOR = 11  # facets with the Fresnel of a metal: `colour` is its index, `edge` its extinction coefficient
    ASHIKHMIN_SHIRLEY = 12  # anisotropic Phong lobe
    SHEEN = 13  # a layer of fibres
    VELVET = 14  # Ashikhmin's; `roughness` is sigma
    HOLDOUT = 15  # cuts a hole into the picture: takes light, and for `weight` of it the film's alpha is 0
    SHEET = 16  # facets that scatter on the other side as GLOSSY's on this one: a rough sheet without thickness
    SUBSURFACE = 17  # light goes in and scatters below: a random walk through the medium (`shading/subsurface.py`)
    # Abilities: not models, but needed by closures whose values ask for them (`Closure.needs`)
    BECKMANN = 32  # `distribution` 1
    ANISOTROPIC = 33  # `aspect` other than 1
    THIN_FILM = 35  # `film_thickness`
    OWN_NORMAL = 34  # `normal`

    @property
    def is_model(self) -> bool:
        """Whether closures can be of this kind."""
        return self < ClosureKind.BECKMANN


class LightKind(IntEnum):
    """Lights without mesh."""

    POINT = 0
    SPOT = 1
    SUN = 2
    RECTANGLE = 3
    ELLIPSE = 4


class CameraKind(IntEnum):
    """Projections."""

    PERSPECTIVE = 0
    ORTHOGRAPHIC = 1


@dataclass(frozen=True)
class Attribute:
    """Numbers across a mesh that shader programs read; see `Scene.attributes`."""

    kind: str
    name: str
    # float32; of corners, shape [triangle_count, 3, width], or of whole triangles, shape [triangle_count, width]. The width tells what it
    # is: 1 a number, 2 a pair, 3 a vector, 4 a colour with alpha
    values: np.ndarray


@dataclass(frozen=True)
class Mesh:
    """Triangles in object space, shared by any number of instances."""

    name: str
    positions: np.ndarray  # [m], float32, shape [vertex_count, 3]
    triangles: np.ndarray  # vertex indices, int32, shape [triangle_count, 3]
    triangle_slot: np.ndarray | None = None  # material slot, int32, shape [triangle_count]; None: slot 0 everywhere
    corner_normals: np.ndarray | None = None  # unit, float32, shape [triangle_count, 3, 3]; None: flat
    corner_uvs: np.ndarray | None = None  # float32, shape [triangle_count, 3, 2]; None: no UV map
    # centre and half size of the box that generated texture coordinates span, in object space [m]; None: -1..1
    texture_space: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    attributes: tuple[Attribute, ...] = ()  # what programs of its materials ask for


@dataclass(frozen=True)
class Closure:
    """One weighted closure of a material; what a kind does not use is ignored."""

    kind: ClosureKind
    weight: tuple[float, float, float]  # linear RGB, >= 0: colour times mix factors (EMISSION: radiance, W/(m² sr))
    roughness: float = 0.0  # Blender's roughness, 0..1; the facets' alpha is its square
    ior: float = 1.5  # of the inside relative to the outside (GLASS, DIELECTRIC, LAYERED_DIFFUSE)
    # METAL: tint at 82 degrees; DIELECTRIC, GLASS: tint at normal incidence; CONDUCTOR: extinction coefficient
    edge: tuple[float, float, float] = (1.0, 1.0, 1.0)
    refraction: tuple[float, float, float] = (1.0, 1.0, 1.0)  # GLASS: what refracts is `weight` times this, what reflects `weight`
    share: float = 1.0  # the mix factors that `weight` contains, where there is no `colour`
    multiscatter: bool = True  # GLOSSY to GLASS, LAYERED_DIFFUSE: add what bounces more than once between facets
    # Colour of a facet without mix factors: GLOSSY, GLASS, ROUGH_DIFFUSE: of what bounces between facets; METAL: reflectance at
    # normal incidence; CONDUCTOR: index of refraction.
    # None: that of `weight`, in which `share` is no colour (METAL, CONDUCTOR: all of it, and the weight is `share`)
    colour: tuple[float, float, float] | None = None
    distribution: int = 0  # of facets: 0 GGX, 1 Beckmann
    aspect: float = 1.0  # of facets: alpha along the tangent is multiplied by it, across it divided
    normal: tuple[float, float, float] = (0.0, 0.0, 0.0)  # in world space; 0: that of the surface
    tangent: tuple[float, float, float] = (0.0, 0.0, 0.0)  # in world space; 0: facets are isotropic
    film_thickness: float = 0.0  # METAL, CONDUCTOR, DIELECTRIC, GLASS: of a film on the facets [nm]; below 0.1 there is none
    film_ior: float = 1.33  # of that film, relative to the outside
    # SUBSURFACE: mean cosine of the phase function. `colour` is the medium's albedo, `edge` its extinction [1/m], `refraction` what a walk's
    # throughput is multiplied by at once; `multiscatter`: half of the light goes in diffusely
    mean_cosine: float = 0.0

    @property
    def needs(self) -> frozenset[ClosureKind]:
        """The kind, and the abilities that its values ask for."""
        abilities = {
            ClosureKind.DIFFUSE: self.kind == ClosureKind.SUBSURFACE,  # where light comes out again
            ClosureKind.BECKMANN: self.distribution == 1,
            ClosureKind.ANISOTROPIC: self.aspect != 1 and any(self.tangent),
            ClosureKind.THIN_FILM: self.film_thickness > 0,
            ClosureKind.OWN_NORMAL: any(self.normal),
        }
        return frozenset([self.kind, *(kind for kind, there in abilities.items() if there)])


@dataclass(frozen=True)
class Material:
    """A named sum of closures; with no closure it is black."""

    name: str
    closures: tuple[Closure, ...] = ()  # those with a weight above 0
    # Kinds that the material's nodes can have when a slider moves (by node kind, not by value):
    # kernels are compiled for these, so that moving a slider never compiles. Includes those of `closures`.
    kinds: tuple[ClosureKind, ...] = ()
    program: Program | None = None  # makes the closures at every point, instead of `closures`


@dataclass(frozen=True)
class Instances:
    """Placements of meshes, one entry an instance."""

    mesh: np.ndarray  # index into `Scene.meshes`, int32, shape [n]
    transform: np.ndarray  # object to world, float32, shape [n, 3, 4]
    slot_first: np.ndarray  # first entry of the instance in `Scene.slot_materials`, int32, shape [n]
    visibility: np.ndarray  # `Visibility` bits, int32, shape [n]
    object: np.ndarray  # index into `Scene.object_names`, int32, shape [n]
    # what shader programs may ask: red, green, blue, alpha of the object's colour, its index, and a random number; float32, shape [n, 6]
    info: np.ndarray | None = None
    attributes: np.ndarray | None = None  # RGBA that programs read by index, of objects and what places them; float32, shape [n, k, 4]

    def __len__(self) -> int:
        return len(self.mesh)

    @staticmethod
    def empty() -> Instances:
        """No instances."""
        none = np.zeros(0, np.int32)
        return Instances(none, np.zeros((0, 3, 4), np.float32), none, none, none)


@dataclass(frozen=True)
class Light:
    """A light without mesh. It shines along its own -Z (SPOT, SUN, RECTANGLE, ELLIPSE)."""

    name: str
    kind: LightKind
    transform: np.ndarray  # light to world, orthonormal axes in the columns, float32, shape [3, 4]
    # POINT, SPOT: radiant intensity (on the axis, before blending) [W/sr]; SUN: irradiance of a
    # surface that faces it [W/m²]; RECTANGLE, ELLIPSE: radiosity / pi, the radiance where `spread` is pi [W/(m² sr)]
    emission: tuple[float, float, float]
    radius: float = 0.0  # POINT, SPOT: of the luminous sphere [m]
    soft_falloff: bool = True  # POINT, SPOT: the light is a disk that faces the shaded point, else a sphere
    angle: float = 0.0  # SUN: angular diameter [rad]; SPOT: full cone angle [rad]
    blend: float = 0.0  # SPOT: share of the cone that is softened, 0..1
    spot_scale: tuple[float, float] = (1.0, 1.0)  # SPOT: width of the cone along x and y relative to z
    size: tuple[float, float] = (1.0, 1.0)  # RECTANGLE, ELLIPSE: full width along x and y [m]
    spread: float = np.pi  # RECTANGLE, ELLIPSE: full angle into which light leaves [rad]
    visibility: int = int(Visibility.ALL)  # kinds of rays that meet the light itself
    casts_shadow: bool = True
    # multiplies `emission` by the sum of its emission closures, in every direction and at every point of the light's shape; None: by 1
    program: Program | None = None
    # what the program may ask of the light's object: its map to the world with all scale and shear, float32, shape [3, 4] (None:
    # `transform`), and a row as of `Instances.info`
    object_transform: np.ndarray | None = None
    info: tuple[float, ...] | None = None
    attributes: np.ndarray | None = None  # as a row of `Instances.attributes`; float32, shape [k, 4]


class ImageEncoding(IntEnum):
    """What the numbers of an image stand for."""

    LINEAR = 0  # linear RGB, or data that are no colour
    SRGB = 1  # the sRGB transfer function; decoded after interpolation, as Blender does


@dataclass(frozen=True)
class Image:
    """A picture that textures read. The bottom row comes first; alpha, where there is any, has been multiplied into the colours.

    With tiles (UDIM) it is many pictures: tile 1001 + 10 v + u covers texture coordinates u..u + 1, v..v + 1.
    A picture without pixels counts as missing, and so does the place of a tile that is not there: magenta.
    """

    name: str
    # uint8 (255 is 1), float16 or float32, shape [height, width, channels] with 1 (grey), 3 (RGB) or 4 (RGBA) channels
    pixels: np.ndarray | None = None
    encoding: ImageEncoding = ImageEncoding.LINEAR
    tiles: tuple[tuple[int, np.ndarray], ...] | None = None  # tile number and its pixels, instead of `pixels`


@dataclass(frozen=True)
class Camera:
    """A camera whose rays pass through a window one metre in front of it (PERSPECTIVE)."""

    kind: CameraKind
    transform: np.ndarray  # camera to world, orthonormal axes in the columns, float32, shape [3, 4]
    # left, right, bottom, top edges of the full frame: on the plane z = -1 (PERSPECTIVE), or on the camera's plane in metres
    window: tuple[float, float, float, float]
    clip_start: float = 0.0  # distance of the near plane along the view axis [m]
    clip_end: float = np.inf  # distance of the far plane along the view axis [m]
    lens_radius: float = 0.0  # radius of the aperture [m]; 0: everything is sharp
    focus_distance: float = 1.0  # distance of the sharp plane along the view axis [m]
    blade_count: int = 0  # edges of the aperture polygon; fewer than 3: a circle
    blade_rotation: float = 0.0  # [rad]
    lens_ratio: float = 1.0  # anamorphic squeeze: width of the aperture is divided by this


@dataclass(frozen=True)
class World:
    """What a ray meets that leaves the scene."""

    radiance: tuple[float, float, float] = (0.0, 0.0, 0.0)  # linear RGB [W/(m² sr)]
    visibility: int = int(Visibility.ALL)
    program: Program | None = None  # makes the radiance of every direction, instead of `radiance`: the sum of its emission closures
    sampling_size: int = 1024  # texels around the world, by whose brightness a program is sampled; 0: it is not


@dataclass(frozen=True)
class Frame:
    """The picture asked for. Pixel (0, 0) is at the bottom left, as in Blender."""

    width: int  # of the full frame [pixels]
    height: int
    border: tuple[int, int, int, int] | None = None  # x0, y0, x1, y1: rendered part (end exclusive); None: all
    transparent: bool = False  # the world does not cover what is behind the objects: alpha
    passes: tuple[str, ...] = ("Combined",)  # names of `film.PASSES`

    @property
    def region(self) -> tuple[int, int, int, int]:
        """x0, y0, x1, y1 of the rendered part [pixels]."""
        return self.border or (0, 0, self.width, self.height)


@dataclass(frozen=True)
class Scene:
    """Everything that one picture shows."""

    camera: Camera
    frame: Frame
    meshes: tuple[Mesh, ...] = ()
    instances: Instances = field(default_factory=Instances.empty)
    # material index by slot; an instance's slot s is `slot_materials[slot_first + s]`. int32, shape [k]
    slot_materials: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    materials: tuple[Material, ...] = ()
    images: tuple[Image, ...] = ()
    attributes: tuple[tuple[str, str], ...] = ()  # kind and name of what programs read of meshes by index
    lights: tuple[Light, ...] = ()
    world: World = World()
    object_names: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()  # what was skipped, repaired or replaced on the way here, by name
