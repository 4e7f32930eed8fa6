"""Ops that make closures of volumes: each gets its weight first, a coefficient [1/m]."""

import warp as wp

from ....scene.description import ClosureKind
from ....shading.bsdf.materials import ClosureRecord, new_closure
from ....shading.volumes.phase import usable_cosine
from ...op import NodeData, closure_op, number, vector
from ...point import ShadingPoint
from .plain import begins, usable_weight


@wp.func
def _scattering(
    kind: int, weight: wp.vec3, first: float, second: float, closures: wp.array(dtype=ClosureRecord), count: int
) -> int:
    """Append a closure of a volume; returns the new count. `first` and `second` as `PhaseLobe` has them."""
    w = usable_weight(weight)
    if not begins(w, closures, count):
        return count
    record = new_closure(kind, w)
    if kind == wp.static(int(ClosureKind.FOURNIER_FORAND)):
        record.ior = first
        record.roughness = second
    else:
        record.mean_cosine = usable_cosine(first)
        record.aspect = second
    closures[count] = record
    return count + 1


@closure_op("volume_absorption", "v")
@wp.func
def volume_absorption(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Absorption: weight."""
    kind = wp.static(int(ClosureKind.VOLUME_ABSORPTION))
    return _scattering(kind, vector(data, stack, pc + 1), 0.0, 0.0, closures, count)


@closure_op("volume_henyey_greenstein", "vn")
@wp.func
def volume_henyey_greenstein(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Scattering by Henyey and Greenstein: weight, mean cosine."""
    kind = wp.static(int(ClosureKind.HENYEY_GREENSTEIN))
    return _scattering(kind, vector(data, stack, pc + 1), number(data, stack, pc + 2), 0.0, closures, count)


@closure_op("volume_fournier_forand", "vnn")
@wp.func
def volume_fournier_forand(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Scattering by particles in water: weight, their index of refraction, share of light that goes back."""
    kind = wp.static(int(ClosureKind.FOURNIER_FORAND))
    index = number(data, stack, pc + 2)
    back = number(data, stack, pc + 3)
    return _scattering(kind, vector(data, stack, pc + 1), index, back, closures, count)


@closure_op("volume_draine", "vnn")
@wp.func
def volume_draine(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Scattering by dust: weight, mean cosine of Henyey and Greenstein's factor, factor of the squared cosine."""
    kind = wp.static(int(ClosureKind.DRAINE))
    g = number(data, stack, pc + 2)
    alpha = wp.max(number(data, stack, pc + 3), 0.0)
    return _scattering(kind, vector(data, stack, pc + 1), g, alpha, closures, count)


@closure_op("volume_rayleigh", "v")
@wp.func
def volume_rayleigh(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Scattering by what is smaller than the wavelength: weight."""
    return _scattering(wp.static(int(ClosureKind.RAYLEIGH)), vector(data, stack, pc + 1), 0.0, 0.0, closures, count)


@wp.func
def mie_fit(d: float) -> wp.vec4:
    """For droplets of `d` micrometres: mean cosine of Henyey and Greenstein's part, of Draine's, its factor of the
    squared cosine, and its share.

    Jendersie and d'Eon, "An Approximate Mie Scattering Function for Fog and Cloud Rendering", 2023, equations 7 to 22
    of the supplement.
    """
    if d <= 0.1:
        size = wp.max(d, 0.0)
        share = 0.252977 - 312.983 * wp.pow(size, 4.3)
        return wp.vec4(13.8 * size * size, 1.1456 * size * wp.sin(9.29044 * size), 250.0, share)
    log_d = wp.log(d)
    if d < 1.5:
        turned = (log_d - 0.238604) * (log_d + 1.00667) / (0.507522 - 0.15677 * log_d)
        angle = 1.19692 * wp.cos(turned) + 1.37932 * log_d + 0.0625835
        share = 0.146209 * wp.cos(3.38707 * log_d + 2.11193) + 0.316072 + 0.0778917 * log_d
        return wp.vec4(0.862 - 0.143 * log_d * log_d, 0.379685 * wp.cos(angle) + 0.344213, 250.0, share)
    if d < 5.0:
        twice = wp.log(log_d)
        draine = 0.500411 - 0.081287 / (wp.tan(log_d) - 2.0 * log_d + 1.27551)
        share = 0.026914 * (log_d - wp.cos(5.68947 * (twice - 0.0292149))) + 0.3764
        return wp.vec4(0.0604931 * twice + 0.940256, draine, 7.30354 * log_d + 6.31675, share)
    return wp.vec4(
        wp.exp(-0.0990567 / (d - 1.67154)),
        wp.exp(-2.20679 / (d + 3.91029) - 0.428934),
        wp.exp(3.62489 - 8.29288 / (d + 5.52825)),
        wp.exp(-0.599085 / (d - 0.641583) - 0.665888),
    )


@closure_op("volume_mie", "vn", most=2)
@wp.func
def volume_mie(
    data: NodeData,
    stack: wp.array(dtype=float),
    pc: int,
    point: ShadingPoint,
    closures: wp.array(dtype=ClosureRecord),
    count: int,
) -> int:
    """Scattering by droplets of water, a mixture: weight, their diameter [micrometres]."""
    weight = vector(data, stack, pc + 1)
    fit = mie_fit(number(data, stack, pc + 2))
    share = wp.clamp(fit[3], 0.0, 1.0)
    henyey_greenstein = wp.static(int(ClosureKind.HENYEY_GREENSTEIN))
    made = _scattering(henyey_greenstein, (1.0 - share) * weight, fit[0], 0.0, closures, count)
    return _scattering(wp.static(int(ClosureKind.DRAINE)), share * weight, fit[1], fit[2], closures, made)
