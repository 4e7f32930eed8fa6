"""Materials on the device: tables of weighted closures, and the data that their evaluation takes.

`shading/bsdf/bsdf.py` holds the functions that evaluate and sample them.
"""

import functools
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import warp as wp

from ...device.codegen.local_arrays import Unset
from ...errors import SceneError
from ...native.build import native_source
from ...native.structs import Upload, record_type, upload_anew
from ...scene.description import Closure, ClosureKind, Material
from .albedo import AlbedoTables, upload_tables

# Kind of a record that is no closure: its `normal` is the surface's normal
SURFACE_NORMAL = 64
# Kind of a record that is no closure: its `weight` is a value for the pass of materials whose number is `distribution`
AOV = 65
_MODEL_BITS = 31  # kinds of models are below

# Events of a sampled path (bits)
DIFFUSE = 1  # reflected by a Lambertian closure
GLOSSY = 2  # reflected by facets
TRANSMISSION = 4  # refracted
TRANSPARENT = 8  # passed straight on
DELTA = 16  # into a direction that no other strategy finds
SUBSURFACE = 32  # entered the medium below the surface, where it scatters on
PORTAL = 64  # sent on elsewhere, with TRANSPARENT

_K = ClosureKind
# facets that reflect and let nothing through
MIRROR_KINDS = frozenset({_K.GLOSSY, _K.METAL, _K.DIELECTRIC, _K.CONDUCTOR})
PASSING_KINDS = frozenset({_K.GLASS, _K.REFRACTION})  # facets that refract
REFLECTION_KINDS = MIRROR_KINDS | {_K.SHEET}  # facets whose albedo is that of reflection
MICROFACET_KINDS = REFLECTION_KINDS | PASSING_KINDS | {_K.ASHIKHMIN_SHIRLEY, _K.SUBSURFACE}
# models that scatter by no facets
DIFFUSE_KINDS = tuple(
    kind
    for kind in _K
    if kind.is_model and kind not in MICROFACET_KINDS | {_K.TRANSPARENT, _K.RAY_PORTAL, _K.EMISSION, _K.HOLDOUT}
)
# fibres, which scatter to all sides
HAIR_KINDS = frozenset(kind for kind in _K if kind.is_hair)
# Ops of programs that may make a closure that lets light pass straight on
TRANSPARENT_OPS = frozenset({"transparent", "sheet", "facet_hair"})
# Light from behind the surface shines through, in other directions than straight on
TRANSMISSIVE_KINDS = PASSING_KINDS | {_K.TRANSLUCENT, _K.SHEET} | HAIR_KINDS
_COAT_KINDS = frozenset({_K.LAYERED_DIFFUSE, _K.DIELECTRIC})
# Indices of refraction are kept in a range whose squares and their inverses are far from the ends of
# float32; beyond it a dielectric reflects more than 99.6 % and is a mirror for all purposes.
IOR_RANGE = (1e-3, 1e3)
FILM_IOR_LEAST = 1e-5
# `ClosureRecord.multiscatter` of glass of which the light that it reflects is left out
NO_REFLECTION = wp.constant(2)
ASPECT_LEAST = 1e-4  # least alpha along one direction over the mean, of anisotropic facets


@dataclass(frozen=True)
class ClosureFeatures:
    """Kinds and abilities that BSDF functions are compiled for."""

    kinds: tuple[ClosureKind, ...] = ()
    half_glass: bool = False  # some GLASS reflects nothing (`NO_REFLECTION`)

    def has(self, *kinds: ClosureKind) -> bool:
        """Whether any of `kinds` is compiled."""
        return any(kind in self.kinds for kind in kinds)

    def test(self, kinds: Iterable[ClosureKind]) -> wp.Function:
        """Function (kind: int) -> bool: whether `kind` is one of `kinds`; kinds that are not compiled cost nothing."""
        return _kind_test(tuple(sorted(int(kind) for kind in kinds if kind in self.kinds)))

    @property
    def scatters(self) -> bool:
        """Whether any closure does more than emit and pass light straight on."""
        others = (_K.EMISSION, _K.TRANSPARENT, _K.HOLDOUT, _K.RAY_PORTAL)
        return any(kind.is_model and kind not in others for kind in self.kinds)

    @property
    def facets(self) -> bool:
        """Whether microfacets are needed."""
        return self.has(*MICROFACET_KINDS)

    @property
    def own_normals(self) -> bool:
        """Whether closures may have a normal of their own."""
        return self.has(_K.OWN_NORMAL)

    @property
    def coats(self) -> bool:
        """Whether the albedo of a dielectric coat is needed."""
        return self.has(*_COAT_KINDS)


@functools.cache
def _kind_test(kinds: tuple[int, ...]) -> wp.Function:
    # Bits, and no loop: where `wp.static` holds a loop's variable Warp generates code anew at each load, and has other
    # names for kernels from then on
    bits = sum(1 << kind for kind in kinds)
    if bits >= 1 << _MODEL_BITS:
        raise ValueError(f"kinds of closures are below {_MODEL_BITS}, not {kinds}")

    @wp.func
    def is_one(kind: int) -> bool:
        return kind < wp.static(_MODEL_BITS) and ((wp.static(bits) >> kind) & 1) != 0

    return is_one


@wp.struct
class ClosureRecord:
    """One weighted closure on the device; what a kind does not use is ignored."""

    kind: int  # `ClosureKind`
    weight: wp.vec3  # linear RGB, >= 0
    roughness: float  # [0, 1]; alpha is its square
    ior: float  # inside over outside
    # colour of a facet without mix factors. GLOSSY, GLASS, ROUGH_DIFFUSE: taken by light that bounces between facets;
    # METAL: reflectance at normal incidence; CONDUCTOR: index of refraction
    color: wp.vec3
    # METAL: tint at 82 degrees; DIELECTRIC, GLASS: tint at normal incidence; CONDUCTOR: extinction coefficient;
    # RAY_PORTAL: where rays go on, if `distribution` is 1 [m]
    edge: wp.vec3
    refraction: wp.vec3  # GLASS: colour of refracted light relative to `weight`
    # 1: light that bounces more than once between facets is added. GLASS that has been looked at: maybe `NO_REFLECTION`
    multiscatter: int
    distribution: int  # BECKMANN: 1
    aspect: float  # ANISOTROPIC: alpha along `tangent` is multiplied by it, across it divided
    # ANISOTROPIC: about along the surface; 0: facets are isotropic. RAY_PORTAL: unit, where rays go; 0: ahead
    tangent: wp.vec3
    film_thickness: float  # THIN_FILM, of METAL, CONDUCTOR, DIELECTRIC and GLASS [nm]; 0: none
    film_ior: float  # relative to the outside
    normal: wp.vec3  # OWN_NORMAL: unit; 0: the normal of the frame
    # SUBSURFACE: mean cosine of the phase function; the medium is in `color`, `edge` and `refraction`, as in `Closure`.
    # TOON: width of the edge
    mean_cosine: float


# Floats of a record: kernels reserve local arrays of records as `wp.zeros(n * RECORD_FLOATS, dtype=Unset)`, which are
# not set to zero, and see them through `wp.array(ptr=address_of(floats), ...)`.
RECORD_FLOATS = ClosureRecord.numpy_dtype()["itemsize"] // 4


@wp.func_native(native_source("math/address.h", FIRST="0"))
def address_of(values: wp.array(dtype=Unset)) -> wp.uint64: ...


@wp.func_native(native_source("math/address.h", FIRST="first"))
def address_of_closure(values: wp.array(dtype=ClosureRecord), first: int) -> wp.uint64:
    """Where the record `first` is."""


@wp.func
def new_closure(kind: int, weight: wp.vec3) -> ClosureRecord:
    """A record whose optional values are neutral, for ops that make closures."""
    one = wp.vec3(1.0, 1.0, 1.0)
    record = ClosureRecord()
    record.kind = kind
    record.weight = weight
    record.ior = 1.5
    record.color = one
    record.edge = one
    record.refraction = one
    record.aspect = 1.0
    record.film_ior = 1.0
    return record


@wp.struct
class MaterialRecord:
    """Facts about a material that are known before it is shaded."""

    closure_first: int  # it has the closures [closure_first, closure_end), but for those that its program makes
    closure_end: int
    transmits: int  # 1: some closure, also of its program, is one of `TRANSMISSIVE_KINDS`
    is_clear: int  # 1: a closure may be TRANSPARENT, also of its program: shadow rays may pass straight on
    bin: int  # the same for materials that run the same code (`material_bins`)


@wp.struct
class MaterialTable:
    """Closures of all materials, one after the other.

    With SUBSURFACE a white Lambertian closure follows them, for light that comes out again.
    """

    records: wp.array(dtype=MaterialRecord)  # [material_count]
    closures: wp.array(dtype=ClosureRecord)  # [closure_count]
    albedo: AlbedoTables  # arrays that the features do not use have length 0


@wp.struct
class ShadingFrame:
    """Directions at a surface point."""

    normal: wp.vec3  # unit shading normal, on the same side as geometric_normal; it may be turned away from wo
    geometric_normal: wp.vec3  # unit, of the triangle, on the side of wo
    tangent: wp.vec3  # unit; with bitangent and normal a right-handed frame
    bitangent: wp.vec3
    entering: int  # 1: wo is in front of the surface, so that refracted light enters the object


@wp.struct
class BsdfValue:
    """Sum over the closures, without delta lobes."""

    value: wp.vec3  # BSDF times |cosine to the shading normal| [1/sr]
    diffuse: wp.vec3  # the part of `value` that is Lambertian
    pdf: float  # density with which `sample` finds the direction [1/sr]


@wp.struct
class BsdfSample:
    """A direction chosen by the BSDF."""

    direction: wp.vec3  # unit, away from the surface
    # BSDF |cosine| / density of all lobes together: a path's throughput is multiplied by it; 0: absorbed
    weight: wp.vec3
    pdf: float  # density as in `BsdfValue` [1/sr]; 0 for delta lobes
    lobe: int  # bits DIFFUSE, GLOSSY, TRANSMISSION, TRANSPARENT, DELTA, SUBSURFACE, PORTAL; 0: absorbed
    closure: int  # index of the closure that chose the direction


class Bsdf(NamedTuple):
    """Functions (`wp.Function`) of one specialisation."""

    # (closures, first, end, albedo, frame, wo, lobes) writes the closures as seen from wo to `lobes`, array of `Lobe`
    # with an entry for each, which the next two read
    look: wp.Function
    # (closures, first, end, lobes, albedo, frame, wo, u_lobe: float, u: vec2) -> BsdfSample: a direction from one
    # closure. A delta lobe is complete; `complete` weighs others
    propose: wp.Function
    mix: wp.Function  # (closures, first, end, lobes, albedo, frame, wo, wi) -> Mixture: sums for one direction
    value: wp.Function  # (mixture) -> BsdfValue: value and density of all lobes but delta lobes; 0: no lobe reaches
    # (proposed: BsdfSample, mixture) -> BsdfSample: weighted as a sample of all closures together. `mixture` is that of
    # the proposed direction
    complete: wp.Function
    emission: wp.Function  # (closures, first, end) -> vec3: radiance [W/(m² sr)], the same on both sides
    transparency: wp.Function  # (closures, first, end) -> vec3: share of light that passes straight on
    # (closures, first, end) -> bool: some lobe is seen by `mix`; without one, shadow rays are in vain
    scatters: wp.Function
    holdout: wp.Function  # (closures, first, end) -> float: share of the film's alpha that the surface takes away


def upload_materials(
    materials: Sequence[Material], features: ClosureFeatures, device, upload: Upload = upload_anew
) -> MaterialTable:
    """The table of `materials` on `device`, each of its arrays copied there by `upload`.

    Roughness and the indices of refraction are brought into their ranges. Raises `SceneError` for a value that is not
    finite or a negative weight, `ValueError` for a kind that `features` lacks.
    """
    closures = [closure for material in materials for closure in material.closures]
    for material in materials:
        for closure in material.closures:
            _check(material, closure, features)
    if features.has(_K.SUBSURFACE):
        closures.append(Closure(_K.DIFFUSE, (1.0, 1.0, 1.0)))
    first = np.cumsum([0] + [len(material.closures) for material in materials], dtype=np.int32)
    records = np.zeros(len(closures), record_type(ClosureRecord))
    for record, closure in zip(records, closures):
        fill_record(record, closure)

    table = MaterialTable()
    rows = np.zeros(len(materials), record_type(MaterialRecord))
    rows["closure_first"], rows["closure_end"] = first[:-1], first[1:]
    rows["transmits"] = [_has_some(material, TRANSMISSIVE_KINDS) for material in materials]
    rows["is_clear"] = [_is_clear(material) for material in materials]
    rows["bin"] = material_bins(materials)
    table.records = upload("material_records", rows, MaterialRecord, device)
    table.closures = upload("closure_records", records, ClosureRecord, device)
    table.albedo = upload_tables(
        device,
        reflection=features.coats or features.has(*REFLECTION_KINDS),
        coat=features.coats,
        glass=features.has(_K.GLASS, _K.FACET_HAIR),
        sheen=features.has(_K.SHEEN),
        film=features.has(_K.THIN_FILM),
        upload=upload,
    )
    return table


def material_bins(materials: Sequence[Material]) -> list[int]:
    """A number for each material, from 0: equal for those that have the same kinds of closures in the same order, or
    whose programs have the same ops.
    """
    numbers: dict[tuple, int] = {}
    return [numbers.setdefault(_code_of(material), len(numbers)) for material in materials]


def _code_of(material: Material) -> tuple:
    if material.program is not None:
        return tuple(instruction.op for instruction in material.program.instructions)
    return tuple(closure.kind for closure in material.closures)


def _has_some(material: Material, wanted: Collection[ClosureKind]) -> bool:
    """Whether a closure is one of the kinds `wanted`; ops that make closures have the names of their kinds."""
    kinds = {ClosureKind(closure.kind).name.lower() for closure in material.closures}
    if material.program is not None:
        kinds = {instruction.op for instruction in material.program.instructions}
    return not kinds.isdisjoint(kind.name.lower() for kind in wanted)


def _is_clear(material: Material) -> bool:
    if material.shadow_opaque:
        return False
    if material.program is not None:  # which makes all of a material's closures
        return any(instruction.op in TRANSPARENT_OPS for instruction in material.program.instructions)
    return any(closure.kind == _K.TRANSPARENT for closure in material.closures)


def constant_closure(record: ClosureRecord) -> Closure:
    """The `Closure` that a `record` made on the host stands for."""
    values = {name: float(getattr(record, name)) for name in _NUMBERS}
    vectors = {name: tuple(float(x) for x in getattr(record, name)) for name in _COLORS + _DIRECTIONS}
    return Closure(
        ClosureKind(record.kind),
        multiscatter=bool(record.multiscatter),
        distribution=int(record.distribution),
        **values,
        **vectors,
    )


_COLORS = ("weight", "color", "edge", "refraction")
_DIRECTIONS = ("normal", "tangent")
_NUMBERS = ("roughness", "ior", "aspect", "film_thickness", "film_ior", "mean_cosine")


def fill_record(record, closure: Closure) -> None:
    """Write `closure` to `record`, a row of records on the host."""
    record["kind"] = int(closure.kind)
    record["weight"], record["color"] = _weight_and_color(closure)
    for name in ("edge", "refraction", "distribution", "multiscatter", *_DIRECTIONS):
        record[name] = getattr(closure, name)
    record["roughness"] = min(max(closure.roughness, 0.0), 1.0)
    record["ior"] = _ior(closure)
    record["aspect"] = max(closure.aspect, ASPECT_LEAST)
    record["mean_cosine"] = closure.mean_cosine
    record["film_thickness"], record["film_ior"] = closure.film_thickness, max(closure.film_ior, FILM_IOR_LEAST)


def _weight_and_color(closure: Closure) -> tuple:
    """Weight of the record, without colour for kinds that have their own, and the colour of a facet."""
    if closure.color is not None:
        return closure.weight, closure.color
    scale = np.float32(1.0 / closure.share) if closure.share > 0 else np.float32(np.inf)
    # a share too small to divide by means a closure too faint to see
    scale = float(scale) if math.isfinite(scale) else 1.0
    color = np.float32(scale) * np.array(closure.weight, np.float32)
    if closure.kind == _K.GLASS:
        return closure.weight, color * np.array(closure.refraction, np.float32)
    if closure.kind in (_K.METAL, _K.CONDUCTOR):
        return (closure.share,) * 3, color
    return closure.weight, color


def _check(material: Material, closure: Closure, features: ClosureFeatures) -> None:
    kind = ClosureKind(closure.kind)
    lacking = sorted(need.name for need in closure.needs if need not in features.kinds)
    if lacking:
        raise ValueError(
            f"material {material.name!r} has a closure that needs {', '.join(lacking)}, which its features lack"
        )
    edge = closure.edge if kind != _K.RAY_PORTAL else ()  # there it is a position
    colors = (*closure.weight, *edge, *closure.refraction, *(closure.color or ()))
    numbers = (
        *colors,
        *closure.edge,
        *closure.normal,
        *closure.tangent,
        closure.roughness,
        closure.ior,
        closure.share,
        closure.aspect,
    )
    numbers = (*numbers, closure.film_thickness, closure.film_ior, closure.mean_cosine)
    if not np.all(np.isfinite(np.asarray(numbers, np.float32))) or min(*colors, closure.share) < 0:
        raise SceneError(
            f"material {material.name!r}: the {kind.name.lower()} closure has a value that is negative, infinite or "
            "not a number; look for such a value in the material's nodes"
        )


def _ior(closure: Closure) -> float:
    least, largest = IOR_RANGE
    return min(max(closure.ior, least), largest)
