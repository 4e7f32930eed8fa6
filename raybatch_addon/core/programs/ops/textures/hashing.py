"""Hashes of numbers and of cells for procedural textures: same input, same output, on every device.

- `hash_bits_*` and all `hash_<n>_to_<m>`: final mix of Bob Jenkins' lookup3 (public domain) over the bits of floats, so
  0.0 and -0.0 differ.
- `cell_to_*`: the PCG hashes in two, three and four dimensions of Jarzynski and Olano, "Hash Functions for GPU
  Rendering" (JCGT 9(3), 2020), with shifts that keep the sign, over integer cells. The choice of both is Blender's.

Results are in [0, 1], both ends included.
"""

import warp as wp

_SEED = 0xDEADBEEF + 13  # of lookup3; plus four times the number of words
_LOOKUP3 = wp.constant(wp.uint32(_SEED))
HASH_SEED_3 = f"{_SEED + 12}u"  # of three words, as C++ spells it
_UNIT_32 = wp.constant(2.0**-32)
UNIT_31 = wp.constant(2.0**-31)
_MULTIPLIER = wp.constant(wp.uint32(1664525))
_INCREMENT = wp.constant(wp.uint32(1013904223))
LOW_31 = wp.constant(wp.uint32(0x7FFFFFFF))


@wp.func
def _rotate(x: wp.uint32, k: wp.uint32) -> wp.uint32:
    return (x << k) | (x >> (wp.uint32(32) - k))


@wp.func
def _final(a: wp.uint32, b: wp.uint32, c: wp.uint32) -> wp.uint32:
    c = (c ^ b) - _rotate(b, wp.uint32(14))
    a = (a ^ c) - _rotate(c, wp.uint32(11))
    b = (b ^ a) - _rotate(a, wp.uint32(25))
    c = (c ^ b) - _rotate(b, wp.uint32(16))
    a = (a ^ c) - _rotate(c, wp.uint32(4))
    b = (b ^ a) - _rotate(a, wp.uint32(14))
    return (c ^ b) - _rotate(b, wp.uint32(24))


@wp.func
def hash_bits_1(x: wp.uint32) -> wp.uint32:
    """Hash of one word."""
    seed = _LOOKUP3 + wp.uint32(4)
    return _final(seed + x, seed, seed)


@wp.func
def hash_bits_2(x: wp.uint32, y: wp.uint32) -> wp.uint32:
    """Hash of two words."""
    seed = _LOOKUP3 + wp.uint32(8)
    return _final(seed + x, seed + y, seed)


@wp.func
def hash_bits_3(x: wp.uint32, y: wp.uint32, z: wp.uint32) -> wp.uint32:
    """Hash of three words."""
    seed = _LOOKUP3 + wp.uint32(12)
    return _final(seed + x, seed + y, seed + z)


@wp.func
def hash_bits_4(x: wp.uint32, y: wp.uint32, z: wp.uint32, w: wp.uint32) -> wp.uint32:
    """Hash of four words: one round of lookup3's mixing over the first three, then the final mix with the fourth."""
    seed = _LOOKUP3 + wp.uint32(16)
    a = seed + x
    b = seed + y
    c = seed + z
    a = (a - c) ^ _rotate(c, wp.uint32(4))
    c = c + b
    b = (b - a) ^ _rotate(a, wp.uint32(6))
    a = a + c
    c = (c - b) ^ _rotate(b, wp.uint32(8))
    b = b + a
    a = (a - c) ^ _rotate(c, wp.uint32(16))
    c = c + b
    b = (b - a) ^ _rotate(a, wp.uint32(19))
    a = a + c
    c = (c - b) ^ _rotate(b, wp.uint32(4))
    b = b + a
    return _final(a + w, b, c)


@wp.func
def unit_of_bits(h: wp.uint32) -> float:
    """32 bits as a number in [0, 1]."""
    return wp.float32(h) * _UNIT_32


@wp.func
def hash_1_to_1(x: float) -> float:
    """Hash of a number."""
    return unit_of_bits(hash_bits_1(wp.cast(x, wp.uint32)))


@wp.func
def hash_2_to_1(x: float, y: float) -> float:
    """Hash of two numbers."""
    return unit_of_bits(hash_bits_2(wp.cast(x, wp.uint32), wp.cast(y, wp.uint32)))


@wp.func
def hash_3_to_1(x: float, y: float, z: float) -> float:
    """Hash of three numbers."""
    return unit_of_bits(hash_bits_3(wp.cast(x, wp.uint32), wp.cast(y, wp.uint32), wp.cast(z, wp.uint32)))


@wp.func
def hash_4_to_1(x: float, y: float, z: float, w: float) -> float:
    """Hash of four numbers."""
    return unit_of_bits(
        hash_bits_4(wp.cast(x, wp.uint32), wp.cast(y, wp.uint32), wp.cast(z, wp.uint32), wp.cast(w, wp.uint32))
    )


@wp.func
def hash_1_to_3(x: float) -> wp.vec3:
    """Three hashes of a number."""
    return wp.vec3(hash_1_to_1(x), hash_2_to_1(x, 1.0), hash_2_to_1(x, 2.0))


@wp.func
def hash_2_to_3(x: float, y: float) -> wp.vec3:
    """Three hashes of two numbers."""
    return wp.vec3(hash_2_to_1(x, y), hash_3_to_1(x, y, 1.0), hash_3_to_1(x, y, 2.0))


@wp.func
def hash_3_to_2(x: float, y: float, z: float) -> wp.vec2:
    """Two hashes of three numbers."""
    return wp.vec2(hash_3_to_1(x, y, z), hash_3_to_1(z, x, y))


@wp.func
def hash_3_to_3(x: float, y: float, z: float) -> wp.vec3:
    """Three hashes of three numbers."""
    return wp.vec3(hash_3_to_1(x, y, z), hash_4_to_1(x, y, z, 1.0), hash_4_to_1(x, y, z, 2.0))


@wp.func
def hash_4_to_2(x: float, y: float, z: float, w: float) -> wp.vec2:
    """Two hashes of four numbers."""
    return wp.vec2(hash_4_to_1(x, y, z, w), hash_4_to_1(z, x, w, y))


@wp.func
def hash_4_to_3(x: float, y: float, z: float, w: float) -> wp.vec3:
    """Three hashes of four numbers."""
    return wp.vec3(hash_4_to_1(x, y, z, w), hash_4_to_1(z, x, w, y), hash_4_to_1(w, z, y, x))


@wp.func
def _fold(x: wp.uint32) -> wp.uint32:
    """`x` with its upper half folded onto the lower, the sign's bit extended."""
    return x ^ wp.uint32(wp.int32(x) >> 16)


@wp.func
def _unit_of_low_bits(x: wp.uint32) -> float:
    return wp.float32(x & LOW_31) * UNIT_31


@wp.func
def cell_to_vec2(i: int, j: int) -> wp.vec2:
    """Two hashes of a cell of the plane."""
    x = wp.uint32(i) * _MULTIPLIER + _INCREMENT
    y = wp.uint32(j) * _MULTIPLIER + _INCREMENT
    x = x + y * _MULTIPLIER
    y = y + x * _MULTIPLIER
    x = _fold(x)
    y = _fold(y)
    x = x + y * _MULTIPLIER
    y = y + x * _MULTIPLIER
    return wp.vec2(_unit_of_low_bits(x), _unit_of_low_bits(y))


@wp.func
def cell_to_vec3(i: int, j: int, k: int) -> wp.vec3:
    """Three hashes of a cell of space."""
    x = wp.uint32(i) * _MULTIPLIER + _INCREMENT
    y = wp.uint32(j) * _MULTIPLIER + _INCREMENT
    z = wp.uint32(k) * _MULTIPLIER + _INCREMENT
    x = x + y * z
    y = y + z * x
    z = z + x * y
    x = _fold(x)
    y = _fold(y)
    z = _fold(z)
    x = x + y * z
    y = y + z * x
    z = z + x * y
    return wp.vec3(_unit_of_low_bits(x), _unit_of_low_bits(y), _unit_of_low_bits(z))


@wp.func
def cell_to_vec4(i: int, j: int, k: int, m: int) -> wp.vec4:
    """Four hashes of a cell of four dimensions."""
    x = wp.uint32(i) * _MULTIPLIER + _INCREMENT
    y = wp.uint32(j) * _MULTIPLIER + _INCREMENT
    z = wp.uint32(k) * _MULTIPLIER + _INCREMENT
    w = wp.uint32(m) * _MULTIPLIER + _INCREMENT
    x = x + y * w
    y = y + z * x
    z = z + x * y
    w = w + y * z
    x = _fold(x)
    y = _fold(y)
    z = _fold(z)
    w = _fold(w)
    x = x + y * w
    y = y + z * x
    z = z + x * y
    w = w + y * z
    return wp.vec4(_unit_of_low_bits(x), _unit_of_low_bits(y), _unit_of_low_bits(z), _unit_of_low_bits(w))
