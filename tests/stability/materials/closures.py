"""Closures evaluated and sampled in kernels, by the probe of the shading tests, on the bench's device."""

from __future__ import annotations

import functools
import math

import numpy as np

from raybatch_addon.core.scene.description import Closure
from raybatch_addon.core.scene.description import ClosureKind as K
from raybatch_addon.core.shading.bsdf.ggx import ALPHA_MIN
from tests.core.shading.bsdf import closure_probe as probe
from tests.stability.bench import Bench
from tests.stability.uniform import SIGMAS

STATISTICS = "Six standard errors, measured over 64 independent sets of stratified samples"
WHITE = probe.WHITE
# Largest roughness of a delta lobe, and the least of a rough one
SMOOTH, LEAST_ROUGH = 0.999 * math.sqrt(ALPHA_MIN), 1.001 * math.sqrt(ALPHA_MIN)
ROUGHNESSES = (0.0, 1e-8, 1e-4, SMOOTH, LEAST_ROUGH, 0.02, 0.06, 0.15, 0.3, 0.5, 0.7, 0.9, 1.0)
COSINES = (1.0, 0.9, 0.7, 0.5, 0.3, 0.2, 0.1)
GRAZING = (0.03, 1e-2, 1e-3, 1e-4, 1e-6)


def plastic(roughness: float, ior: float, base=WHITE, share: float = 1.0) -> tuple[Closure, ...]:
    """A dielectric coat above a diffuse base."""
    coat = Closure(K.DIELECTRIC, (share,) * 3, roughness, ior, share=share)
    return coat, Closure(K.LAYERED_DIFFUSE, tuple(share * c for c in base), roughness, ior, share=share)


def sample(bench: Bench, closures, wo, count: int, entering: int = 1, u=None, seed: int = 0):
    """Samples: direction [n, 3], weight [n, 3], pdf [n], lobe [n]; stratified without `u`."""
    return probe.sample(
        tuple(closures), wo, count, probe.frame_of(entering=entering), u=u, seed=seed, device=bench.device
    )


def evaluate(bench: Bench, closures, wo, wi, entering: int = 1):
    """Values: value [n, 3] with the cosine, pdf [n]."""
    return probe.evaluate(tuple(closures), wo, wi, probe.frame_of(entering=entering), device=bench.device)


SETS = 64  # sets of samples, independent of each other, each stratified


@functools.cache
def _sets(side: int) -> np.ndarray:
    return np.concatenate([probe.stratified(side * side, seed) for seed in range(SETS)])


def albedo(bench: Bench, closures, cosine: float, entering: int = 1, side: int = 16) -> tuple[float, float]:
    """Directional albedo of the channel that reflects most, and its statistical error.

    The error is six standard errors, from the spread of `SETS` independent sets of `side` x `side` stratified samples.
    """
    weight = sample(bench, closures, probe.toward(cosine), 0, entering, _sets(side))[1]
    channel = int(np.argmax(weight.mean(0)))
    means = weight[:, channel].reshape(SETS, -1).mean(1)
    return float(means.mean()), SIGMAS * float(means.std(ddof=1)) / math.sqrt(SETS)
