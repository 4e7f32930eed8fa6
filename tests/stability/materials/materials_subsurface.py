"""Random walks below surfaces: against the theory of half-spaces, and without absorption."""

from __future__ import annotations

import itertools

import numpy as np

from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.ops.closures.soft import SubsurfaceMethod
from raybatch_addon.core.scene.description import Closure, Material
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.shading.bsdf.materials import constant_closure
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.materials.closures import WHITE
from tests.stability.uniform import PIXELS, SIGMAS, STATISTICS, UNIT_ROUNDOFF
from tests.support import scenes

_KINDS = tuple(kind for kind in K if not kind.is_hair)
_IOR = 1.01  # the least index that there is


def _rendered(bench: Bench, mesh, closures, objects=(), sample_count: int = 64, **view) -> np.ndarray:
    """Values of the pixels, each independent, shape [pixels, 3]."""
    surface = Material("material", tuple(closures), _KINDS)
    scene = scenes.scene(
        [(mesh, scenes.IDENTITY, surface), *objects], view=scenes.camera(**view), frame=PIXELS, world=1.0
    )
    return bench.render(scene, sample_count=sample_count, bounce_max=64, roulette_bounce=65).reshape(-1, 3)


def _add_means(sweep: Sweep, values: np.ndarray, expected, loss: float, note: str) -> None:
    """Compare each channel's mean, which may be at most `loss` below `expected`."""
    error = values.std(0, ddof=1) / np.sqrt(len(values))
    for channel, (mean, each) in enumerate(zip(values.mean(0), np.broadcast_to(expected, 3), strict=True)):
        bound = SIGMAS * float(error[channel]) + 64 * UNIT_ROUNDOFF + (loss if mean < each else 0.0)
        sweep.add(float(mean), float(each), bound, f"{note}, channel {channel}")


def half_space_albedo(albedo: float, cosine: float) -> float:
    """Albedo of a half-space of isotropic scattering for light from `cosine`: 1 - H(cosine) sqrt(1 - albedo).

    By Chandrasekhar's H-function ("Radiative Transfer", 1960, section 38), iterated in float64.
    """
    nodes, weights = np.polynomial.legendre.leggauss(200)
    mu, weights = (nodes + 1) / 2, weights / 2
    root = np.sqrt(1 - albedo)
    h = np.ones_like(mu)
    for _ in range(2000):
        h = 1 / (root + albedo / 2 * (weights * mu * h / (mu[:, None] + mu)).sum(1))
    return 1 - root / (root + albedo / 2 * (weights * mu * h / (cosine + mu)).sum())


@case(
    "walks below half-spaces",
    "materials",
    "A smooth plane over a medium of isotropic scattering whose albedo differs by channel, and whose mean free path "
    "differs too, or not: the albedo for light from two angles is 1 - H(cos) sqrt(1 - albedo), by Chandrasekhar's "
    "H-function in float64.",
    f"{STATISTICS}. Walks end after 256 steps: the share that scatters so often is below 0.04, and carries albedo^256 "
    "of its light.",
)
def half_spaces(bench: Bench) -> Outcome:
    """Sweep over albedos, extinctions and angles."""
    sweep = Sweep()
    ground = scenes.plane(size=40.0)
    for albedo, extinction in itertools.product(
        ((0.95, 0.8, 0.5), (0.3, 0.98, 0.2)), ((50.0, 50.0, 50.0), (20.0, 100.0, 400.0))
    ):
        for degrees in (0.0, 60.0):
            t = np.radians(degrees)
            closure = Closure(K.SUBSURFACE, WHITE, 0.0, _IOR, color=albedo, edge=extinction, multiscatter=False)
            view = dict(eye=(0.0, -4 * np.sin(t), 4 * np.cos(t)), half_width=1e-6, up=(0.0, 1.0, 0.1))
            values = _rendered(bench, ground, (closure,), sample_count=128, **view)
            inside = np.sqrt(1 - (np.sin(t) / _IOR) ** 2)
            for channel, each in enumerate(albedo):
                note = f"albedo {each:g}, extinction {extinction[channel]:g}, {degrees:g} degrees"
                mean, error = values[:, channel].mean(), values[:, channel].std(ddof=1) / np.sqrt(len(values))
                sweep.add(
                    float(mean), half_space_albedo(each, inside), SIGMAS * float(error) + 0.04 * each**256 + 1e-4, note
                )
    return sweep.outcome()


@case(
    "furnace: walks that nothing absorbs",
    "materials",
    "A ball and a thin box of a medium of albedo 0.999999, in a white world: they are invisible, whatever their "
    "thickness in mean free paths, the roughness of their surface and the direction of scattering; also with another "
    "object inside, which walks do not see.",
    f"{STATISTICS}. Gains: none. Losses: 1e-6 of each scattering, and walks of more than 256 steps, 0.02 at most of "
    "objects as thick as here; rays of a rough surface that would not go in, 0.06 at most.",
)
def furnace_subsurface(bench: Bench) -> Outcome:
    """Sweep over shapes, mean free paths, roughnesses and mean cosines."""
    sweep = Sweep()
    ball, sheet = scenes.sphere(segments=24, rings=12), scenes.box(size=1.0)
    flat = np.diag((2.0, 2.0, 0.1, 1.0))[:3]
    sheet = type(sheet)(sheet.name, (sheet.positions @ flat[:, :3].T).astype(np.float32), sheet.triangles)
    inner = (
        scenes.sphere("inner", 8, 4, 0.3),
        scenes.IDENTITY,
        Material("inner", (Closure(K.DIFFUSE, (0.1, 0.1, 0.1)),), _KINDS),
    )
    for (name, mesh, objects), free in itertools.product(
        (("ball", ball, ()), ("ball around another", ball, (inner,)), ("sheet", sheet, ())), (10.0, 0.3)
    ):
        for roughness, g in ((0.0, 0.0), (0.0, 0.8), (0.6, -0.5)):
            medium = dict(
                color=(0.999999,) * 3, edge=(1 / free, 2 / free, 0.5 / free), mean_cosine=g, multiscatter=False
            )
            values = _rendered(
                bench,
                mesh,
                (Closure(K.SUBSURFACE, WHITE, roughness, 1.4, **medium),),
                objects,
                32,
                eye=(0.5, -3.0, 1.0),
            )
            note = f"{name}, free path {free:g}, roughness {roughness:g}, g {g:g}"
            _add_means(sweep, values, 1.0, 0.02 if roughness == 0 else 0.08, note)
    return sweep.outcome()


@case(
    "media of colours",
    "materials",
    "Media made of a colour by each method, as Blender's nodes make them: the colour of a large plane of the medium "
    "under a white sky is that colour, within the error of the inversions.",
    f"{STATISTICS}, and 0.02 of the colour: d'Eon's and Chiang's inversions are fits, for light that goes in "
    "diffusely.",
)
def medium_colors(bench: Bench) -> Outcome:
    """Sweep over methods and colours."""
    sweep = Sweep()
    ground = scenes.plane(size=40.0)
    for method in SubsurfaceMethod:
        for color in ((0.9, 0.5, 0.2), (0.05, 0.7, 0.8)):
            builder = ProgramBuilder()
            builder.closure("subsurface", WHITE, color, (0.03, 0.02, 0.01), 0.0, method, 1.0, 1.4, (0.0, 0.0, 0.0))
            closures = tuple(constant_closure(record) for record in builder.constant_closures())
            values = _rendered(
                bench, ground, closures, sample_count=16, eye=(0.0, -2.0, 3.0), half_width=1e-6, up=(0.0, 1.0, 0.1)
            )
            error = values.std(0, ddof=1) / np.sqrt(len(values))
            for channel, each in enumerate(color):
                note = f"{method.name.lower()}, {each:g} of {color}"
                sweep.add(float(values[:, channel].mean()), each, SIGMAS * float(error[channel]) + 0.02, note)
    return sweep.outcome()
