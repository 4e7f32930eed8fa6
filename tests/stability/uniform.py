"""Pictures in which every pixel expects the same value: their mean, its standard error, and its bound."""

from __future__ import annotations

import math

import numpy as np

from raybatch_addon.core.scene.description import (
    Closure,
    ClosureKind,
    Frame,
    Light,
    LightKind,
    Material,
    Scene,
    Visibility,
)
from tests.stability.case import Sweep
from tests.support import scenes

UNIT_ROUNDOFF = 2.0**-24  # of float32
# Standard errors by which a mean may be off. Six occur once in 5e8 normal values, and once in 1e8 of Student's t with
# the 255 degrees of freedom that the smallest picture has. The suite makes fewer than 10,000 such comparisons: a false
# alarm in one run of all has a probability below 1e-4.
SIGMAS = 6.0

STATISTICS = "Six standard errors of the mean, measured over the pixels, which are independent"
ROUNDING = 64 * UNIT_ROUNDOFF  # error of a sample: the products, quotients and roots from a light to the film

PIXELS = Frame(16, 16)
UNSEEN = int(Visibility.ALL & ~Visibility.CAMERA)  # for lights between the camera and the object that it looks at
# kernels are compiled for these kinds, whichever of them a scene has
KINDS = (ClosureKind.DIFFUSE, ClosureKind.EMISSION)


def mean_and_error(picture: np.ndarray) -> tuple[float, float]:
    """Mean of the first channel over pixels, which are independent, and its standard error."""
    values = picture[..., 0].ravel()
    # scaled, since squares of 1e-300 and 1e300 leave float64
    largest = float(np.abs(values).max())
    if not largest > 0 or not math.isfinite(largest):
        return float(values.mean()), 0.0
    return float(values.mean()), float((values / largest).std(ddof=1)) / math.sqrt(len(values)) * largest


def add_mean(sweep: Sweep, picture: np.ndarray, expected: float, rounding: float, note: str = "") -> None:
    """Compare the mean of `picture` with `expected`.

    `rounding` is the relative error that arithmetic or the model may add.
    """
    mean, error = mean_and_error(picture)
    sweep.add(mean, expected, SIGMAS * error + rounding * abs(expected), note)


def emitter(radiance: float) -> Material:
    """Material that emits, and nothing else."""
    return Material("emitter", (Closure(ClosureKind.EMISSION, (radiance,) * 3),), KINDS)


def diffuse(albedo: float = 1.0) -> Material:
    """Lambertian material."""
    return Material("diffuse", (Closure(ClosureKind.DIFFUSE, (albedo,) * 3),), KINDS)


def point_light(position, intensity: float = 1.0, **more) -> Light:
    """A POINT of radiant intensity `intensity` [W/sr] at `position` [m]."""
    return Light("point", LightKind.POINT, scenes.translation(*position), (intensity,) * 3, visibility=UNSEEN, **more)


def floor_of(
    *lights: Light, objects=(), size: float = 4.0, world: float = 0.0, eye=(0.0, -1e-3, 1.0), half_width: float = 1e-5
) -> Scene:
    """A white floor in z = 0 whose origin fills the picture, so that a pixel's value is irradiance over pi.

    `half_width`: half width of the seen spot [m], from an eye that is 1 m away: irradiance hardly changes over it.
    """
    view = scenes.camera(eye=eye, half_width=half_width)
    return scenes.scene(
        [(scenes.plane("floor", size), scenes.IDENTITY, diffuse()), *objects],
        view=view,
        frame=PIXELS,
        lights=lights,
        world=world,
    )
