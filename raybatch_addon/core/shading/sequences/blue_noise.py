"""Low-discrepancy points that are spread over the samples of a pixel and over neighbouring pixels alike, so that the
errors of neighbours differ: what is left of the noise at few samples is fine-grained, which eyes and denoisers smooth.

Neighbours are found by Morton's curve through the frame, whose blocks of 4^j pixels are squares (Ahmed and Wonka 2020,
"Screen-space blue-noise diffusion of Monte Carlo sampling error via hierarchical ordering of pixels"). There a pixel's
place on the curve and a sample's index are written one behind the other, for a number of samples that is fixed
beforehand. Here the points of *any* 4^k first samples of *any* aligned square of 4^j pixels are a (0, j + k, 2)-net in
base 4, so that samples can be added for as long as one likes.

That takes numbers whose digits are elements of the field of four, 0, 1, w and w + 1. Digit i of the pixel's place
stands for the function z^i, digit i of the sample's index for (z - w)^-(i + 1), and the number that is asked for is the
sum of all of them: its derivatives at z = 0, one a digit, are the first coordinate of the point, those at z = 1 the
second. The first j and k functions have a common denominator of degree k and a numerator of degree less than j + k, so
none but 0 vanishes j + k times in all at the two places: the digits of the points are as many, and the functions
different, hence every box of the net has one point. Over the field of two there are not enough places.

Rows and columns of these matrices may be scaled, and a digit's two bits mapped to any two others, without changing
that; the maps below are chosen such that a pixel's samples alone are a (0, 2)-sequence in base 2 too, as Sobol's.
"""

import numpy as np
import warp as wp

from .keys import mix_bits, sequence_number, set_seed
from .sobol import reverse_bits, scramble_reversed

_DIGITS = 16  # of 32 bits; the lower bit of a digit says whether 1 is in it, the upper one whether w is
_ONE = np.eye(2, dtype=int)
_W = np.array([[0, 1], [1, 1]])  # multiplication by w
_POWERS = (_ONE, _W, _W @ _W % 2)
_SWAP = np.array([[0, 1], [1, 0]])
# Maps of digits that make the samples of a pixel a (0, 2)-sequence in base 2, for digits 0, 1, 2, 3 ... in turn: of the
# sample's index, of the first and of the second coordinate. Found by trying
_INDEX = (_SWAP, _ONE, np.array([[1, 0], [1, 1]]))
_FIRST = (_SWAP, np.array([[1, 1], [0, 1]]), _ONE)
_SECOND = (np.array([[1, 1], [0, 1]]), _SWAP, _ONE)


def _by_digit(*maps) -> wp.Function:
    """Function (x: uint32) -> uint32: digit r of x times the matrix number r mod 3, where `maps` are applied from the
    last to the first.
    """
    keep = up = down = 0
    for r in range(_DIGITS):
        m = _ONE
        for each in maps:
            m = m @ each[r % 3] % 2
        keep |= int(m[0, 0]) << 2 * r | int(m[1, 1]) << 2 * r + 1
        up |= int(m[1, 0]) << 2 * r
        down |= int(m[0, 1]) << 2 * r + 1

    @wp.func
    def by_digit(x: wp.uint32) -> wp.uint32:
        kept = x & wp.uint32(wp.static(keep))
        return (
            kept ^ ((x & wp.uint32(wp.static(up))) << wp.uint32(1)) ^ ((x & wp.uint32(wp.static(down))) >> wp.uint32(1))
        )

    return by_digit


_times_w = _by_digit((_W,) * 3)
_index_first = _by_digit(_INDEX)
_index_second = _by_digit((_POWERS[0], _POWERS[2], _POWERS[1]), _INDEX)  # w^(2r)
_place_first = _by_digit(_POWERS)
_place_second = _by_digit((_POWERS[1], _POWERS[0], _POWERS[2]))  # w^(2r + 1)
_out_first = _by_digit(_FIRST)
_out_second = _by_digit(_SECOND)


@wp.func
def _derivatives_of_poles(x: wp.uint32) -> wp.uint32:
    """Digit r of the result: the sum of the digits i of x for which C(i + r, r) is odd, that is i & r = 0; the fourth
    Kronecker power of [[1, 1], [1, 0]].
    """
    x = ((x ^ (x >> wp.uint32(2))) & wp.uint32(0x33333333)) | ((x & wp.uint32(0x33333333)) << wp.uint32(2))
    x = ((x ^ (x >> wp.uint32(4))) & wp.uint32(0x0F0F0F0F)) | ((x & wp.uint32(0x0F0F0F0F)) << wp.uint32(4))
    x = ((x ^ (x >> wp.uint32(8))) & wp.uint32(0x00FF00FF)) | ((x & wp.uint32(0x00FF00FF)) << wp.uint32(8))
    return ((x ^ (x >> wp.uint32(16))) & wp.uint32(0x0000FFFF)) | ((x & wp.uint32(0x0000FFFF)) << wp.uint32(16))


@wp.func
def _derivatives_of_powers(x: wp.uint32) -> wp.uint32:
    """Digit r of the result: the sum of the digits i of x for which C(i, r) is odd (Pascal's triangle)."""
    x = x ^ ((x >> wp.uint32(2)) & wp.uint32(0x33333333))
    x = x ^ ((x >> wp.uint32(4)) & wp.uint32(0x0F0F0F0F))
    x = x ^ ((x >> wp.uint32(8)) & wp.uint32(0x00FF00FF))
    return x ^ ((x >> wp.uint32(16)) & wp.uint32(0x0000FFFF))


@wp.func
def _spread(x: wp.uint32) -> wp.uint32:
    """The lower 16 bits of x at the even places."""
    x = x & wp.uint32(0x0000FFFF)
    x = (x | (x << wp.uint32(8))) & wp.uint32(0x00FF00FF)
    x = (x | (x << wp.uint32(4))) & wp.uint32(0x0F0F0F0F)
    x = (x | (x << wp.uint32(2))) & wp.uint32(0x33333333)
    return (x | (x << wp.uint32(1))) & wp.uint32(0x55555555)


@wp.func
def place_key(seed: wp.uint32, x: wp.uint32, y: wp.uint32, frame_width: wp.uint32) -> wp.vec2ui:
    """Key of a pixel's random numbers: of all pixels, and its place on Morton's curve with its bits reversed. Pixels
    that are 2^16 apart have the same.
    """
    return wp.vec2ui(mix_bits(seed + wp.uint32(0x85EBCA6B)), reverse_bits(_spread(x) | (_spread(y) << wp.uint32(1))))


@wp.func
def _shuffled_place(place: wp.uint32, seed: wp.uint32) -> wp.uint32:
    """Place on a curve that takes the quarters of every square in an order of its own, one of all 24."""
    shuffled = scramble_reversed(place, mix_bits(seed + wp.uint32(3)))
    # such bits depend on what lies before a bit alone; those of lower bits are the same for all quarters of a square
    turned = (scramble_reversed(place, mix_bits(seed + wp.uint32(4))) ^ place) & wp.uint32(0x55555555)
    shuffled = shuffled ^ ((shuffled ^ _times_w(shuffled)) & (turned * wp.uint32(3)))
    return reverse_bits(shuffled)


@wp.func
def _shuffled_sample(sample: wp.uint32, place: wp.uint32, seed: wp.uint32) -> wp.uint32:
    """Samples in an order of every pixel's own, in which the first 2^k remain the first, for all k."""
    own = mix_bits(seed + mix_bits(place))
    return reverse_bits(scramble_reversed(reverse_bits(sample), own) ^ scramble_reversed(wp.uint32(0), own))


@wp.func
def _first(sample: wp.uint32, place: wp.uint32, seed: wp.uint32) -> float:
    digits = _out_first(_derivatives_of_poles(_index_first(sample)) ^ _place_first(place))
    return sequence_number(reverse_bits(scramble_reversed(digits, mix_bits(seed + wp.uint32(1)))))


@wp.func
def _second(sample: wp.uint32, place: wp.uint32, seed: wp.uint32) -> float:
    of_place = _place_second(_derivatives_of_powers(place))
    digits = _out_second(_derivatives_of_poles(_index_second(sample)) ^ of_place)
    return sequence_number(reverse_bits(scramble_reversed(digits, mix_bits(seed + wp.uint32(2)))))


@wp.func
def blue_noise_1d(key: wp.vec2ui, sample: wp.uint32, dimension: wp.uint32) -> float:
    """The first coordinate of `blue_noise_2d`."""
    seed = set_seed(key[0], dimension)
    index = _shuffled_sample(sample, key[1], seed)
    return _first(index, _shuffled_place(key[1], seed), seed)


@wp.func
def blue_noise_2d(key: wp.vec2ui, sample: wp.uint32, dimension: wp.uint32) -> wp.vec2:
    """A point of a set's sequence, Owen-scrambled for all pixels alike."""
    seed = set_seed(key[0], dimension)
    index = _shuffled_sample(sample, key[1], seed)
    place = _shuffled_place(key[1], seed)
    return wp.vec2(_first(index, place, seed), _second(index, place, seed))
