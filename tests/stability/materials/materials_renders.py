"""Whole renders of materials at their ends."""

from __future__ import annotations

import itertools
import math

import numpy as np

from raybatch_addon.core.scene.description import Closure, Frame, Material
from raybatch_addon.core.scene.description import ClosureKind as K
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.materials.closures import LEAST_ROUGH, SMOOTH, WHITE, plastic
from tests.stability.uniform import PIXELS, SIGMAS, STATISTICS, UNIT_ROUNDOFF, add_mean, mean_and_error
from tests.support import scenes

# kernels are compiled for all of these kinds, whichever a scene has
_KINDS = tuple(kind for kind in K if not kind.is_hair)


def _of(*closures: Closure) -> Material:
    return Material("material", closures, _KINDS)


def _seen(mesh, surface: Material, world: float = 1.0, objects=(), **view):
    """One object in a uniform world."""
    return scenes.scene(
        [(mesh, scenes.IDENTITY, surface), *objects], view=scenes.camera(**view), frame=PIXELS, world=world
    )


@case(
    "furnace render: a ball of every material",
    "materials",
    "A faceted ball of each closure and of stacks of them, white, rough and smooth, in a white world: it is "
    "invisible. The whole picture's mean, with paths of 64 bounces (from glass nothing else comes out).",
    f"{STATISTICS}. Known losses of a scattering, 0.004 for reflection and 0.03 for glass, where the picture sees "
    "each twice on average; gains of 4e-3.",
)
def furnace_renders(bench: Bench) -> Outcome:
    """Sweep over materials."""
    ball = scenes.sphere(segments=24, rings=12)
    materials = {
        "diffuse": (0.0, (Closure(K.DIFFUSE, WHITE),)),
        "transparent": (0.0, (Closure(K.TRANSPARENT, WHITE),)),
        "mirror": (0.0, (Closure(K.GLOSSY, WHITE, 0.0),)),
        "glossy 1e-8": (0.0, (Closure(K.GLOSSY, WHITE, 1e-8),)),
        "glossy": (0.008, (Closure(K.GLOSSY, WHITE, 0.5),)),
        "metal": (0.008, (Closure(K.METAL, WHITE, 1.0),)),
        "smooth glass": (0.0, (Closure(K.GLASS, WHITE, 0.0, 1.5),)),
        "rough glass": (0.06, (Closure(K.GLASS, WHITE, 0.5, 1.5),)),
        "glass of index 100": (0.06, (Closure(K.GLASS, WHITE, 0.3, 100.0),)),
        "glass of index 0.1": (0.06, (Closure(K.GLASS, WHITE, 0.3, 0.1),)),
        "plastic": (0.008, plastic(0.4, 1.5)),
        "plastic of index 100": (0.008, plastic(0.4, 100.0)),
    }
    sweep = Sweep()
    for name, (loss, closures) in materials.items():
        mean, error = mean_and_error(
            bench.render(_seen(ball, _of(*closures)), sample_count=32, bounce_max=64, roulette_bounce=65)
        )
        rounding = 64 * 4 * UNIT_ROUNDOFF
        sweep.add(mean, 1.0, (loss if mean < 1 else min(loss, 4e-3)) + SIGMAS * error + rounding, name)
    return sweep.outcome()


@case(
    "mirrors of roughness 0 to the least that is rough",
    "materials",
    "A mirror shows a lamp of radiance 3 that fills its reflection: roughness 0, 1e-8, 1e-4 and the largest that is a "
    "delta lobe; and the least that is not, whose lobe of a quarter of a milliradian sees the same lamp.",
    "Weights of 1 and roundings of three products; the rough ones: six standard errors, and the 2e-3 by which their "
    "table of albedos errs.",
    quick=True,
)
def mirrors(bench: Bench) -> Outcome:
    """Sweep over roughnesses."""
    sweep = Sweep()
    lamp = (scenes.plane("lamp", 4.0), scenes.translation(0, 4, 3), _of(Closure(K.EMISSION, (3.0,) * 3)))
    for kind, roughness in itertools.product((K.GLOSSY, K.METAL), (0.0, 1e-8, 1e-4, SMOOTH, LEAST_ROUGH)):
        scene = _seen(
            scenes.plane(size=2), _of(Closure(kind, WHITE, roughness)), 0.0, [lamp], eye=(0, -4, 3), half_width=1e-2
        )
        is_delta = roughness <= SMOOTH
        bound = 16 * UNIT_ROUNDOFF if is_delta else 2e-3
        add_mean(sweep, bench.render(scene, sample_count=16), 3.0, bound, f"{kind.name.lower()} {roughness:g}")
    return sweep.outcome()


@case(
    "glass of index 1",
    "materials",
    "A glass ball of index 1, smooth and rough, before a lamp and a black world: the picture is the one without it.",
    "No difference but for one pixel of 576: light goes straight on, and where a facet's edge is seen, paths lose "
    "nothing either. At 1 + 1e-7 reflection is 2.5e-15 and light is bent by 1e-7: 1e-5 of the radiance for pixels in "
    "which its shift by 1e-7 crosses the lamp's edge.",
)
def clear_glass(bench: Bench) -> Outcome:
    """Sweep over indices and roughnesses."""
    lamp = (scenes.plane("lamp", 1.3), scenes.look_at((0, 3, 0), (0, 0, 0)), _of(Closure(K.EMISSION, (3.0,) * 3)))
    without = bench.render(scenes.scene([lamp], view=scenes.camera(), frame=Frame(24, 24), world=0.0), sample_count=4)
    sweep = Sweep()
    for ior, roughness in itertools.product((1.0, 1.0 + 1e-7), (0.0, 0.3, 1.0)):
        ball = (scenes.sphere(segments=24, rings=12), scenes.IDENTITY, _of(Closure(K.GLASS, WHITE, roughness, ior)))
        picture = bench.render(
            scenes.scene([ball, lamp], view=scenes.camera(), frame=Frame(24, 24), world=0.0), sample_count=4
        )
        # a sample in 2,304 may fall on the other side of the lamp's edge
        same = float((np.abs(picture - without) < 1e-5).mean())
        sweep.add(same, 1.0, 1 / 576 + 1e-9, f"index {ior:.7g}, roughness {roughness:g}: share of equal pixels")
    return sweep.outcome()


@case(
    "glass of index 0.1 and 100 by Fresnel",
    "materials",
    "A smooth pane's front, seen at several angles: what it reflects of a white world, its inside black (a pane's "
    "other side absorbs all): Fresnel's equations in float64.",
    f"{STATISTICS} (the side is chosen at random), and 1e-5: Fresnel's float32 error.",
)
def fresnel_of_glass(bench: Bench) -> Outcome:
    """Sweep over indices and angles."""
    from tests.core.shading.bsdf.closure_probe import fresnel

    sweep = Sweep()
    black = (scenes.plane("black", 4000.0), scenes.translation(0, 0, -1e-2), _of())
    for ior, degrees in itertools.product((0.1, 1.0, 1.5, 100.0), (0.0, 5.0, 30.0, 80.0, 89.0)):
        t = math.radians(degrees)
        eye = (0.0, -4 * math.sin(t), 4 * math.cos(t))
        # parallel rays, so that all meet the pane at one angle; light that its front lets through is lost in black
        pane = _of(Closure(K.GLASS, WHITE, 0.0, ior))
        scene = _seen(
            scenes.plane(size=40.0),
            pane,
            1.0,
            [black],
            eye=eye,
            half_width=1e-4,
            up=(0, 1, 0) if degrees < 1 else (0, 0, 1),
        )
        reflected = float(fresnel(math.cos(t), ior)) if ior != 1 else 0.0
        add_mean(
            sweep,
            bench.render(scene, sample_count=512, bounce_max=8),
            reflected,
            1e-5,
            f"index {ior:g}, {degrees:g} degrees",
        )
    return sweep.outcome()


@case(
    "metal seen at grazing angles",
    "materials",
    "A white metal plane seen at 89 to 89.9999 degrees in a white world: as bright as the world.",
    f"{STATISTICS}, and losses of 2.5e-3 and gains of 1e-3 of its table of albedos; smooth: 8 roundings.",
)
def grazing_planes(bench: Bench) -> Outcome:
    """Sweep over angles and roughnesses."""
    sweep = Sweep()
    for degrees, roughness in itertools.product((89.0, 89.9, 89.99, 89.9999), (0.0, LEAST_ROUGH, 0.2, 1.0)):
        t = math.radians(degrees)
        metal = _of(Closure(K.METAL, WHITE, roughness))
        scene = _seen(scenes.plane(size=1e4), metal, eye=(0, -4 * math.sin(t), 4 * math.cos(t)), half_width=1e-8)
        mean, error = mean_and_error(bench.render(scene, sample_count=32))
        loss = (2.5e-3 if mean < 1 else 1e-3) if roughness else 8 * UNIT_ROUNDOFF
        sweep.add(mean, 1.0, loss + SIGMAS * error, f"{degrees:g} degrees, roughness {roughness:g}")
    return sweep.outcome()


@case(
    "veils of transparency 0 to 1",
    "materials",
    "A lamp behind 1 to 100 transparent panes: the product of their transparencies, exactly 1 for clear ones.",
    "One rounding a pane; nothing is chosen at random.",
    quick=True,
)
def veils(bench: Bench) -> Outcome:
    """Sweep over transparencies and numbers of veils."""
    sweep = Sweep()
    for passes, count in itertools.product((1.0, 0.5, 1.0 - 2.0**-24, 1e-3, 0.0), (1, 10, 100)):
        veil = _of(Closure(K.TRANSPARENT, (passes,) * 3)) if passes else _of()
        panes = [(scenes.plane(f"veil {i}"), scenes.look_at((0, 1e-3 * i, 0), (0, -1, 0)), veil) for i in range(count)]
        scene = scenes.scene(panes, view=scenes.camera(half_width=0.1), frame=PIXELS, world=1.0)
        picture = bench.render(scene, sample_count=1, transparent_bounce_max=1024)
        expected = float(np.float32(passes)) ** count
        # below the normal numbers of float32 only smallness is promised
        tolerance = count * UNIT_ROUNDOFF * expected if expected > 1e-37 or not expected else 1.2e-38
        sweep.add(picture.mean(), expected, tolerance, f"{count} panes of {passes:.9g}")
    return sweep.outcome()


@case(
    "albedo 0 and 1e-30",
    "materials",
    "A black ball and one of albedo 1e-30 in a world of 1 and of 1e30: nothing, and 1e-30 times the world's radiance.",
    "A facet of a convex ball sees nothing but the world, so that nothing is left to chance: the product of two "
    "numbers, 8 roundings.",
)
def faint_albedo(bench: Bench) -> Outcome:
    """Sweep over albedos and worlds."""
    sweep = Sweep()
    ball = scenes.sphere(segments=24, rings=12)
    for albedo, world in itertools.product((0.0, 1e-30, 1e-7), (1.0, 1e30)):
        surface = _of(Closure(K.DIFFUSE, (albedo,) * 3)) if albedo else _of()
        picture = bench.render(_seen(ball, surface, world, half_width=0.01), sample_count=4, roulette_bounce=65)
        sweep.add(picture.mean() / world, albedo, 8 * UNIT_ROUNDOFF * albedo, f"albedo {albedo:g}, world {world:g}")
    return sweep.outcome()
