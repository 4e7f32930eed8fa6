"""The published hashes, written over Python's integers."""

WORD = 0xFFFFFFFF


def rotate(x, k):
    return (x << k | x >> (32 - k)) & WORD


def jenkins(words):
    """lookup3 over one to four words."""
    seed = (0xDEADBEEF + 4 * len(words) + 13) & WORD
    a, b, c = ((seed + word) & WORD for word in (*words[:3], 0, 0, 0)[:3])
    if len(words) == 4:
        a, b, c = mix(a, b, c)
        a = (a + words[3]) & WORD
    for index, k in enumerate((14, 11, 25, 16, 4, 14, 24)):
        if index % 3 == 0:
            c = ((c ^ b) - rotate(b, k)) & WORD
        elif index % 3 == 1:
            a = ((a ^ c) - rotate(c, k)) & WORD
        else:
            b = ((b ^ a) - rotate(a, k)) & WORD
    return c


def mix(a, b, c):
    for index, k in enumerate((4, 6, 8, 16, 19, 4)):
        if index % 3 == 0:
            a, c = ((a - c) ^ rotate(c, k)) & WORD, (c + b) & WORD
        elif index % 3 == 1:
            b, a = ((b - a) ^ rotate(a, k)) & WORD, (a + c) & WORD
        else:
            c, b = ((c - b) ^ rotate(b, k)) & WORD, (b + a) & WORD
    return a, b, c


def pcg(cell):
    """PCG in as many dimensions as `cell` has, over signed words."""
    count = len(cell)
    v = [(int(x) * 1664525 + 1013904223) & WORD for x in cell]

    def stir():
        for index in range(count):
            if count == 2:
                v[index] = (v[index] + v[1 - index] * 1664525) & WORD
            else:
                first, second = {3: ((1, 2), (2, 0), (0, 1)), 4: ((1, 3), (2, 0), (0, 1), (1, 2))}[count][index]
                v[index] = (v[index] + v[first] * v[second]) & WORD

    stir()
    for index, x in enumerate(v):
        v[index] = x ^ (((x - (1 << 32) if x >> 31 else x) >> 16) & WORD)
    stir()
    return [(x & 0x7FFFFFFF) / 2**31 for x in v]
