"""Random numbers of ways through volumes: each piece of a path's way, and of its shadow ray's, has its own."""

from __future__ import annotations

import warp as wp

from ..sequences.keys import DIMENSIONS_PER_BOUNCE, mix_bits, sequence_number

# Dimension sets of pieces: above those of walks below surfaces
_FIRST_DIMENSION = 3 << 30
CHANNEL, LENGTH, LIT_CHANNEL, LIT_LENGTH, LIGHTS = range(5)  # behind LIGHTS those of a vertex
_PIECE_DIMENSIONS = LIGHTS + DIMENSIONS_PER_BOUNCE
# Streams of shadow rays are others than those of paths
SHADOW_STREAM = 1 << 31
# The choice of points from which light is looked for has a stream of its own
LIT_STREAM = 0x2545F491
# So have points at which light of volumes is weighed
EMISSION_STREAM = 0x6C8E9CF5


@wp.func
def piece_dimension(segment: int) -> wp.uint32:
    """The first dimension set of piece number `segment` of a path's way."""
    return wp.uint32(wp.static(_FIRST_DIMENSION)) + wp.uint32(segment * wp.static(_PIECE_DIMENSIONS))


@wp.func
def stream_of(key: wp.vec2ui, sample: wp.uint32, piece: wp.uint32) -> wp.uint32:
    """Seed of as many random numbers as a piece needs."""
    return mix_bits(key[0] + mix_bits(key[1] + mix_bits(sample + mix_bits(piece + wp.uint32(0x68BC21EB)))))


@wp.func
def stream_number(stream: wp.uint32, index: wp.uint32) -> float:
    """Number `index` of a stream, in [0, 1)."""
    return sequence_number(mix_bits(stream + mix_bits(index + wp.uint32(0x9E3779B9))))
