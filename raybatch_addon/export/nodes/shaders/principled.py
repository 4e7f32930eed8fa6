"""The Principled BSDF: layers of closures, each of which takes its share from those below.

From the top: transparency takes 1 - alpha of all. Sheen and coat take what they reflect, as seen from the ray's origin;
emission is seen through both. Metal takes its share of the rest, and glass takes its own of what metal leaves. The
remainder goes to a dielectric above a base that is diffuse or a medium.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

from ....core.programs.builder import Value
from ....core.programs.ops.closures.facets import Distribution
from ....core.programs.ops.closures.soft import SubsurfaceMethod
from ....core.scene.description import Closure, ClosureKind
from ....core.shading.bsdf.materials import constant_closure
from ..node import BLACK, WHITE, Graph, Node
from ..registry import shader
from .diffuse import subsurface_method
from .facets import anisotropy, distribution, thin_film

_K = ClosureKind
KINDS = (_K.TRANSPARENT, _K.EMISSION, _K.METAL, _K.GLASS, _K.DIELECTRIC, _K.LAYERED_DIFFUSE)
_ONE, _NONE = Value.of(1.0), Value.of(0.0)


@dataclass(frozen=True)
class Coat:
    """A layer of varnish."""

    weight: Value
    roughness: Value
    ior: Value
    tint: Value
    normal: Value  # 0: the surface's normal


@dataclass(frozen=True)
class Sheen:
    """A layer of fibres."""

    weight: Value
    roughness: Value
    tint: Value


@dataclass(frozen=True)
class Subsurface:
    """A medium below the surface, which replaces a share of the diffuse base."""

    weight: Value
    radius: Value  # by channel [m]
    mean_cosine: Value
    method: SubsurfaceMethod = SubsurfaceMethod.RANDOM_WALK
    ior: Value | None = None  # index of the surface where light goes in; None: that of the specular layer


@dataclass(frozen=True)
class Layers:
    """Inputs of the BSDF; a layer that is None does not exist."""

    base: Value
    metallic: Value
    roughness: Value
    _: KW_ONLY
    ior: Value = Value.of(1.5)
    level: Value = Value.of(0.5)  # specular level: the reflectance of the specular layer is multiplied by twice this
    tint: Value = WHITE  # colour of reflected light: at the edge for metal, at normal incidence for the rest
    transmission: Value = _NONE
    alpha: Value = _ONE
    emission: Value = BLACK  # radiance
    distribution: Distribution = Distribution.MULTI_GGX
    normal: Value = BLACK  # 0: the surface's normal
    aspect: Value = _ONE
    tangent: Value = BLACK
    film: tuple[Value, Value] = (_NONE, _ONE)  # thickness [nm] and index
    diffuse_roughness: Value | None = None
    coat: Coat | None = None
    sheen: Sheen | None = None
    thin: bool = False  # glass is a sheet with two surfaces
    behind: Value = _NONE  # share of diffuse light that leaves a thin wall on its other side
    subsurface: Subsurface | None = None

    @property
    def tinted(self) -> bool:
        """Whether the reflection of the specular layer may be coloured."""
        return self.tint.constant != WHITE.constant

    @property
    def filmed(self) -> bool:
        """Whether there may be a thin film."""
        return self.film[0].constant != _NONE.constant


@shader(
    "ShaderNodeBsdfPrincipled",
    kinds=lambda node: _kinds(node),  # noqa: PLW0108 (defined below)
    note="Christensen-Burley's subsurface scattering is rendered as a random walk",
)
def principled(node: Node, weight: Value) -> None:
    """The Principled BSDF."""
    _note_approximations(node)
    aspect, tangent = anisotropy(node, "principled_aspect", "Anisotropic", "Anisotropic Rotation")
    strength = node.number("Emission Strength")
    if strength.known and strength.number() < 0:
        node.warn("negative Emission Strength, taken as 0,")
    layers = Layers(
        base=node.color("Base Color"),
        metallic=node.number("Metallic"),
        roughness=node.number("Roughness"),
        ior=node.number("IOR"),
        level=node.number("Specular IOR Level"),
        tint=node.color("Specular Tint"),
        transmission=node.number("Transmission Weight"),
        alpha=node.number("Alpha"),
        emission=node.times(node.color("Emission Color"), strength),
        distribution=distribution(node),
        normal=node.own_normal(),
        aspect=aspect,
        tangent=tangent,
        film=thin_film(node),
        diffuse_roughness=node.number("Diffuse Roughness") if node.used("Diffuse Roughness") else None,
        coat=_coat(node),
        sheen=_sheen(node),
        thin=_is_thin(node),
        behind=_behind(node),
        subsurface=_subsurface(node),
    )
    add_layers(node, weight, layers)


def add_layers(node: Node, weight: Value, layers: Layers) -> None:
    """Add the closures of the BSDF."""
    through, weight = node.op("mix_weights", weight, layers.alpha)
    node.closure("transparent", through)
    if layers.sheen is not None:
        weight = _add_sheen(node, weight, layers, layers.sheen)
    if layers.coat is not None:
        coat = layers.coat
        coat_weight, weight, ior = node.op(
            "layer_coat", weight, coat.weight, coat.roughness, coat.ior, coat.tint, coat.normal
        )
        node.closure(
            "dielectric",
            coat_weight,
            WHITE,
            Distribution.GGX,
            coat.roughness,
            ior,
            1.0,
            BLACK,
            coat.normal,
            _NONE,
            _ONE,
        )
    node.closure("emission", node.times(layers.emission, weight))
    facets = (layers.distribution, layers.roughness)
    turned = (layers.aspect, layers.tangent, layers.normal, *layers.film)
    weight, metal = node.op("mix_weights", weight, layers.metallic)
    node.closure("metal", metal, layers.base, layers.tint, *facets, *turned)
    weight, glass = node.op("mix_weights", weight, layers.transmission)
    if layers.thin:
        _add_thin_glass(node, glass, layers)
    else:
        refraction = node.op("refraction_tint", layers.base)
        node.closure(
            "glass", glass, refraction, refraction, layers.tint, *facets, layers.ior, layers.normal, *layers.film
        )
    ior = node.op("specular_index", layers.ior, layers.level)
    node.closure("dielectric", weight, layers.tint, *facets, ior, *turned)
    plain = layers.diffuse_roughness is None and layers.behind.constant == _NONE.constant and layers.subsurface is None
    if plain and not layers.tinted and not layers.filmed:
        node.closure("layered_diffuse", node.times(layers.base, weight), *facets, ior, layers.normal)
        return
    if weight.constant == BLACK.constant:  # all is metal or glass
        below = weight
    elif layers.filmed:
        below = node.op("layer_film", weight, layers.tint, ior, layers.normal, *layers.film)
    else:
        below = node.op("layer_specular", weight, layers.tint, *facets, ior, layers.normal)
    if layers.subsurface is not None:
        medium = layers.subsurface
        below, inside = node.op("mix_weights", below, medium.weight)
        node.closure(
            "subsurface",
            inside,
            layers.base,
            medium.radius,
            medium.mean_cosine,
            medium.method,
            layers.roughness,
            ior if medium.ior is None else medium.ior,
            layers.normal,
        )
    weight = node.times(layers.base, below)
    if layers.behind.constant != _NONE.constant:
        weight, through = node.op("mix_weights", weight, layers.behind)
        node.closure("translucent", through, layers.normal)
    if layers.diffuse_roughness is None:
        node.closure("diffuse", weight, layers.normal)
    else:
        node.closure("rough_diffuse", weight, layers.base, layers.diffuse_roughness, layers.normal)


def _add_sheen(node: Node, weight: Value, layers: Layers, sheen: Sheen) -> Value:
    """Add fibres; returns the part of `weight` that they leave."""
    coat = layers.coat
    coat_normal, share = (layers.normal, _NONE) if coat is None else (coat.normal, coat.weight)
    fibres, below, normal = node.op(
        "layer_sheen", weight, sheen.weight, sheen.tint, sheen.roughness, layers.normal, coat_normal, share
    )
    node.closure("sheen", fibres, sheen.roughness, normal)
    return below


def _add_thin_glass(node: Node, weight: Value, layers: Layers) -> None:
    """Add a sheet of glass."""
    reflected, passed = weight, BLACK
    if weight.constant != BLACK.constant:
        sheet = (weight, layers.base, layers.tint, layers.ior, layers.normal)
        if layers.filmed:
            reflected, passed = node.op("layer_thin_glass_film", *sheet, *layers.film)
        else:
            reflected, passed = node.op("layer_thin_glass", *sheet)
    node.closure("glossy", reflected, layers.tint, Distribution.MULTI_GGX, layers.roughness, _ONE, BLACK, layers.normal)
    node.closure("sheet", passed, layers.roughness, layers.ior, layers.normal)


def layered_closures(layers: Layers) -> tuple[Closure, ...]:
    """The closures of `layers`, which are constants."""
    graph = Graph()
    add_layers(Node(graph, None), WHITE, layers)
    records = graph.builder.constant_closures()
    assert records is not None  # of constants
    return tuple(map(constant_closure, records))


def _kinds(node: Node) -> set[ClosureKind]:
    """Kinds that the node always can have, and those that its current values ask for."""
    extra = {
        (_K.ANISOTROPIC,): node.used("Anisotropic"),
        (_K.SHEEN,): node.used("Sheen Weight"),
        (_K.THIN_FILM, _K.DIFFUSE): node.used("Thin Film Thickness"),
        (_K.ROUGH_DIFFUSE, _K.DIFFUSE): node.used("Diffuse Roughness"),
        (_K.DIFFUSE,): node.color("Specular Tint").constant != WHITE.constant,
        (_K.GLOSSY, _K.SHEET): _is_thin(node),
        (_K.TRANSLUCENT, _K.DIFFUSE): _is_thin(node) and node.used("Subsurface Weight"),
        (_K.SUBSURFACE, _K.DIFFUSE): not _is_thin(node) and node.used("Subsurface Weight"),
    }
    return {*KINDS, *(kind for kinds, there in extra.items() if there for kind in kinds)}


def _is_thin(node: Node) -> bool:
    return node.used("Thin Wall")


def _behind(node: Node) -> Value:
    """Share of a thin wall's diffuse light that subsurface scattering sends through."""
    if not _is_thin(node) or not node.used("Subsurface Weight"):
        return _NONE
    return node.op("forward_share", node.number("Subsurface Weight"), node.number("Subsurface Anisotropy"))


def _coat(node: Node) -> Coat | None:
    if not node.used("Coat Weight"):
        return None
    normal = node.own_normal("Coat Normal") if node.linked("Coat Normal") else node.own_normal()
    weight, roughness, ior = (node.number(f"Coat {name}") for name in ("Weight", "Roughness", "IOR"))
    return Coat(weight, roughness, ior, node.color("Coat Tint"), normal)


def _sheen(node: Node) -> Sheen | None:
    if not node.used("Sheen Weight"):
        return None
    return Sheen(node.number("Sheen Weight"), node.number("Sheen Roughness"), node.color("Sheen Tint"))


def _subsurface(node: Node) -> Subsurface | None:
    if not node.used("Subsurface Weight") or _is_thin(node):
        return None
    method = subsurface_method(node, node.node.subsurface_method)
    return Subsurface(
        node.number("Subsurface Weight"),
        node.times(node.vector("Subsurface Radius"), node.as_vector(node.number("Subsurface Scale"))),
        node.number("Subsurface Anisotropy"),
        method,
        node.number("Subsurface IOR") if method == SubsurfaceMethod.SKIN else None,
    )


def _note_approximations(node: Node) -> None:
    if _is_thin(node) and not node.number("Thin Wall").known:
        node.warn("Thin Wall is taken as on everywhere; this is an input")
