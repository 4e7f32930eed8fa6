"""Keys of random numbers: a pixel, a sample of it, and a decision of its path.

A number is a pure function of (seed, pixel of the full frame, sample, dimension set): threads, tiles and the order of
work never enter. A *dimension set* is one decision of a path (see the constants). Each set is a sequence of its own
over the sample index, and sets are padded against each other. A set of three dimensions takes two numbers: the points
that one choice leaves over are then well distributed among themselves, as points of two padded sets are not.
"""

import warp as wp

# Dimension sets. FILTER and LENS belong to bounce 0, TIME to none; the others are added to
# `bounce * DIMENSIONS_PER_BOUNCE`.
DIMENSIONS_PER_BOUNCE = 8
FILTER = 0  # 2D: point of the pixel filter
LENS = 1  # 2D: point of the aperture
LIGHT = 2  # 3D: point of a light, and which light
BSDF = 4  # 3D: direction, and which closure and which side of it
ROULETTE = 6  # 1D: whether the path goes on
TEXTURE = 7  # 1D: which level of images
TIME = 0xFFFFFFFF  # 1D: when the path is, for all of it

ULP_BELOW_ONE = wp.constant(2.0**-24)  # spacing of the 24-bit points, and of floats in [0.5, 1)


@wp.func
def mix_bits(x: wp.uint32) -> wp.uint32:
    """A bijective hash of 32 bits (shape by Wellons, "hash prospector", two rounds)."""
    x = x ^ (x >> wp.uint32(16))
    x = x * wp.uint32(0x21F0AAAD)
    x = x ^ (x >> wp.uint32(15))
    x = x * wp.uint32(0xD35A2D97)
    return x ^ (x >> wp.uint32(15))


@wp.func
def hashed_key(seed: wp.uint32, x: wp.uint32, y: wp.uint32, frame_width: wp.uint32) -> wp.vec2ui:
    """Key of the random numbers of the pixel in column `x` and row `y` of the full frame (at most 2**32 pixels), for
    sequences that are another in every pixel: a hash, and 0.

    For one seed no two pixels share a key. The pixel is hashed before the seed enters, so that two seeds never give the
    same pattern shifted.
    """
    pixel = y * frame_width + x
    key = mix_bits(mix_bits(pixel + wp.uint32(0x9E3779B9)) ^ mix_bits(seed + wp.uint32(0x85EBCA6B)))
    return wp.vec2ui(key, wp.uint32(0))


@wp.func
def set_seed(key: wp.uint32, dimension: wp.uint32) -> wp.uint32:
    """Seed of a dimension set's sequence."""
    return mix_bits(key + mix_bits(dimension + wp.uint32(0xC2B2AE35)))


@wp.func
def sequence_number(x: wp.uint32) -> float:
    """The upper 24 bits as a number in [0, 1 - 2**-24], exact in float32."""
    return wp.float32(x >> wp.uint32(8)) * ULP_BELOW_ONE
