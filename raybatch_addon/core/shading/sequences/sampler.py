"""The choice of a sequence of random numbers.

Points of the unit square are in [0, 1) with 24 bits.
"""

import functools
from typing import NamedTuple

import warp as wp

from .blue_noise import blue_noise_1d, blue_noise_2d, place_key
from .independent import philox_1d, philox_2d
from .keys import hashed_key
from .sobol import sobol_1d, sobol_2d, sobol_3d


class Sampler(NamedTuple):
    """Functions (`wp.Function`) of one sequence."""

    # (seed, x, y, frame_width), all uint32 -> vec2ui: key of the random numbers of the pixel in column x and row y of
    # the full frame
    pixel_key: wp.Function
    # (key: vec2ui, sample: uint32, dimension: uint32)
    sample_1d: wp.Function  # -> float in [0, 1)
    sample_2d: wp.Function  # -> vec2 in [0, 1)^2
    sample_3d: wp.Function  # -> vec3 in [0, 1)^3, of the sets `dimension` and `dimension + 1`


def _padded_3d(sample_1d: wp.Function, sample_2d: wp.Function) -> wp.Function:
    """The function `sample_3d` of a sequence that has no more than two dimensions, or needs none."""

    @wp.func
    def padded_3d(key: wp.vec2ui, sample: wp.uint32, dimension: wp.uint32) -> wp.vec3:
        u = sample_2d(key, sample, dimension + wp.uint32(1))
        return wp.vec3(u[0], u[1], sample_1d(key, sample, dimension))

    return padded_3d


_SAMPLERS = {
    "SOBOL": Sampler(hashed_key, sobol_1d, sobol_2d, sobol_3d),
    "BLUE_NOISE": Sampler(place_key, blue_noise_1d, blue_noise_2d, _padded_3d(blue_noise_1d, blue_noise_2d)),
    "INDEPENDENT": Sampler(hashed_key, philox_1d, philox_2d, _padded_3d(philox_1d, philox_2d)),
}


@functools.cache
def make_sampler(sequence: str) -> Sampler:
    """The `Sampler` of `sequence`: a value of `RenderSettings.sample_sequence`."""
    if sequence not in _SAMPLERS:
        raise ValueError(f"no sample sequence is called {sequence!r}; there are {', '.join(_SAMPLERS)}")
    return _SAMPLERS[sequence]
