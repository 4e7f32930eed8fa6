"""Owen-scrambled Sobol points: low-discrepancy points, others in every pixel."""

import warp as wp

from ...native.build import native_source
from .keys import mix_bits, sequence_number, set_seed


@wp.func_native(native_source("math/reverse_bits.h"))
def reverse_bits(x: wp.uint32) -> wp.uint32: ...


@wp.func
def scramble_reversed(x: wp.uint32, seed: wp.uint32) -> wp.uint32:
    """Owen scrambling of a number whose bits are reversed: each bit is flipped by a hash of those below.

    Laine and Karras (2011) with Vegdahl's constants (2021), which leave no visible structure.
    """
    x = x ^ (x * wp.uint32(0x3D20ADEA))
    x = x + seed
    x = x * ((seed >> wp.uint32(16)) | wp.uint32(1))
    x = x ^ (x * wp.uint32(0x05526C56))
    return x ^ (x * wp.uint32(0x53A22864))


@wp.func
def _sobol_second(x: wp.uint32) -> wp.uint32:
    """Second Sobol dimension of index `x`, with its bits reversed (the first is `x` itself).

    Its matrix is Pascal's triangle mod 2, the fifth Kronecker power of [[1, 1], [0, 1]]: five steps.
    """
    x = x ^ ((x >> wp.uint32(1)) & wp.uint32(0x55555555))
    x = x ^ ((x >> wp.uint32(2)) & wp.uint32(0x33333333))
    x = x ^ ((x >> wp.uint32(4)) & wp.uint32(0x0F0F0F0F))
    x = x ^ ((x >> wp.uint32(8)) & wp.uint32(0x00FF00FF))
    return x ^ ((x >> wp.uint32(16)) & wp.uint32(0x0000FFFF))


def _third_numbers() -> list[int]:
    """What each bit of an index, the lowest first, adds to the third Sobol dimension with its bits reversed: that of
    the polynomial x^2 + x + 1 (Joe and Kuo 2008).
    """
    m = [1, 3]
    for _ in range(30):
        m.append(2 * m[-1] ^ 4 * m[-2] ^ m[-2])
    return [int(f"{number:0{bit + 1}b}"[::-1], 2) for bit, number in enumerate(m)]


@wp.func_native(native_source("sequences/sobol_third.h", THIRD=", ".join(f"{each}u" for each in _third_numbers())))
def _sobol_third(x: wp.uint32) -> wp.uint32: ...


@wp.func
def _shuffled_index(sample: wp.uint32, seed: wp.uint32) -> wp.uint32:
    # a nested shuffle: every aligned block of 2**k samples stays an aligned block of the sequence
    return reverse_bits(scramble_reversed(reverse_bits(sample), seed))


@wp.func
def sobol_1d(key: wp.vec2ui, sample: wp.uint32, dimension: wp.uint32) -> float:
    """First dimension of a set's Sobol pair, Owen-scrambled (Burley, "Practical Hash-based Owen Scrambling", 2020)."""
    seed = set_seed(key[0], dimension)
    index = _shuffled_index(sample, seed)
    return sequence_number(reverse_bits(scramble_reversed(index, mix_bits(seed + wp.uint32(1)))))


@wp.func
def sobol_2d(key: wp.vec2ui, sample: wp.uint32, dimension: wp.uint32) -> wp.vec2:
    """An Owen-scrambled (0,2)-sequence with shuffled index, one for each set (Burley 2020)."""
    seed = set_seed(key[0], dimension)
    index = _shuffled_index(sample, seed)
    x = reverse_bits(scramble_reversed(index, mix_bits(seed + wp.uint32(1))))
    y = reverse_bits(scramble_reversed(_sobol_second(index), mix_bits(seed + wp.uint32(2))))
    return wp.vec2(sequence_number(x), sequence_number(y))


@wp.func
def sobol_3d(key: wp.vec2ui, sample: wp.uint32, dimension: wp.uint32) -> wp.vec3:
    """The first three dimensions of a Sobol sequence, Owen-scrambled, with shuffled index (Burley 2020); the first two
    are a (0, 2)-sequence.
    """
    seed = set_seed(key[0], dimension)
    index = _shuffled_index(sample, seed)
    x = reverse_bits(scramble_reversed(index, mix_bits(seed + wp.uint32(1))))
    y = reverse_bits(scramble_reversed(_sobol_second(index), mix_bits(seed + wp.uint32(2))))
    z = reverse_bits(scramble_reversed(_sobol_third(index), mix_bits(seed + wp.uint32(3))))
    return wp.vec3(sequence_number(x), sequence_number(y), sequence_number(z))
