"""Sequences of random numbers: how evenly they fill, and that they depend on their key alone."""

import functools
import math

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.shading.sequences import sobol
from raybatch_addon.core.shading.sequences.independent import philox
from raybatch_addon.core.shading.sequences.keys import (
    BSDF,
    DIMENSIONS_PER_BOUNCE,
    FILTER,
    LENS,
    LIGHT,
    ROULETTE,
    TEXTURE,
)
from raybatch_addon.core.shading.sequences.sampler import make_sampler
from tests.support.under_test import BLOCK_DIM, DEVICE

SEQUENCES = ("SOBOL", "BLUE_NOISE", "INDEPENDENT")
WIDTH = 1920  # of the frame


def load(kernel):
    kernel.module.load(wp.get_device(DEVICE), block_dim=BLOCK_DIM)
    return kernel


def launch(kernel, count, inputs, outputs):
    wp.launch(kernel, count, inputs=inputs, outputs=outputs, device=DEVICE, block_dim=BLOCK_DIM)


@functools.cache
def number_kernel(sequence):
    sampler = make_sampler(sequence)

    @wp.kernel(**KERNEL_OPTIONS)
    def numbers(
        seed: wp.uint32,
        pixel: wp.array(dtype=wp.uint32),
        sample: wp.array(dtype=wp.uint32),
        dimension: wp.uint32,
        one: wp.array(dtype=float),
        two: wp.array(dtype=wp.vec2),
        three: wp.array(dtype=wp.vec3),
    ):
        i = wp.tid()
        p = pixel[i]
        width = wp.uint32(wp.static(WIDTH))
        key = sampler.pixel_key(seed, p % width, p / width, width)
        one[i] = sampler.sample_1d(key, sample[i], dimension)
        two[i] = sampler.sample_2d(key, sample[i], dimension)
        three[i] = sampler.sample_3d(key, sample[i], dimension)

    return load(numbers)


def all_numbers(sequence, samples, pixels=0, dimension=LIGHT, seed=0):
    """1D numbers, shape [n], 2D numbers, shape [n, 2], and 3D numbers, shape [n, 3]."""
    samples, pixels = np.broadcast_arrays(samples, pixels)
    found = [wp.zeros(samples.size, dtype=each, device=DEVICE) for each in (float, wp.vec2, wp.vec3)]
    arrays = [wp.array(a.astype(np.uint32).ravel(), dtype=wp.uint32, device=DEVICE) for a in (pixels, samples)]
    launch(number_kernel(sequence), samples.size, [seed, *arrays, dimension], found)
    return [each.numpy() for each in found]


def numbers(*arguments, **options):
    """The first two of `all_numbers`."""
    return all_numbers(*arguments, **options)[:2]


@pytest.mark.parametrize("dimension", [FILTER, BSDF, 7 * DIMENSIONS_PER_BOUNCE + LIGHT])
@pytest.mark.parametrize("pixel", [0, 1, 123_456])
@pytest.mark.parametrize("sequence", ["SOBOL", "BLUE_NOISE"])
def test_samples_fill_every_elementary_interval_once(sequence, pixel, dimension):
    """A (0,2)-sequence: any aligned 2**k samples have one point in each dyadic box of area 2**-k."""
    one, two = numbers(sequence, np.arange(1024), pixel, dimension)
    for log in (1, 4, 8):
        for block in range(0, 1024, 2**log):
            points = two[block : block + 2**log].astype(np.float64)
            for first in range(log + 1):
                boxes = (points * [2**first, 2 ** (log - first)]).astype(int) @ [1, 2**first]
                assert len(np.unique(boxes)) == 2**log
            assert len(np.unique((one[block : block + 2**log] * 2**log).astype(int))) == 2**log


@pytest.mark.parametrize("dimension", [BSDF, 7 * DIMENSIONS_PER_BOUNCE + LIGHT])
@pytest.mark.parametrize("pixel", [0, 123_456])
def test_three_sobol_dimensions_fill_every_elementary_interval_alike(pixel, dimension):
    """The first three Sobol dimensions are a (1,3)-sequence: any aligned 2**k samples have two points in each dyadic
    box of volume 2**(1 - k). So points that one choice leaves over, such as those with the third below 1/4, are well
    distributed in the square. The first two are a (0,2)-sequence.
    """
    three = all_numbers("SOBOL", np.arange(512), pixel, dimension)[2].astype(np.float64)
    for log in (4, 7):
        for block in range(0, 512, 2**log):
            points = three[block : block + 2**log]
            for first in range(log):
                for second in range(log - first):
                    sides = np.array([first, second, log - 1 - first - second])
                    boxes = (points * 2**sides).astype(int) @ [1, 2**first, 2 ** (first + second)]
                    assert (np.bincount(boxes, minlength=2 ** (log - 1)) == 2).all(), sides
            for first in range(log + 1):
                boxes = (points[:, :2] * [2**first, 2 ** (log - first)]).astype(int) @ [1, 2**first]
                assert len(np.unique(boxes)) == 2**log


@pytest.mark.parametrize("sequence", ["BLUE_NOISE", "INDEPENDENT"])
def test_three_numbers_of_other_sequences_are_those_of_two_sets(sequence):
    samples = np.arange(64)
    three = all_numbers(sequence, samples, 5, LIGHT)[2]
    np.testing.assert_array_equal(three[:, 2], numbers(sequence, samples, 5, LIGHT)[0])
    np.testing.assert_array_equal(three[:, :2], numbers(sequence, samples, 5, LIGHT + 1)[1])


@pytest.mark.parametrize("dimension", [FILTER, LIGHT, 5 * DIMENSIONS_PER_BOUNCE + BSDF])
@pytest.mark.parametrize("corner", [(0, 0), (64, 128), (1912, 8)])
def test_blue_noise_is_shared_out_among_pixels(corner, dimension):
    """The first 4**k samples of the pixels of any aligned square of 4**j are a net in base 4, in one dimension and in
    two, for all j and k: neighbours, and squares of neighbours, have what others lack.
    """
    for j in range(4):
        for k in range(4):
            count = 4 ** (j + k)
            axes = np.arange(2**j) + corner[0], np.arange(2**j) + corner[1], np.arange(4**k)
            x, y, sample = (each.ravel() for each in np.meshgrid(*axes))
            one, two = numbers("BLUE_NOISE", sample, y * WIDTH + x, dimension, seed=11)
            assert len(np.unique((one * count).astype(int))) == count
            for first in range(j + k + 1):
                sides = [4**first, 4 ** (j + k - first)]
                boxes = (two.astype(np.float64) * sides).astype(int) @ [1, sides[0]]
                assert len(np.unique(boxes)) == count


def errors(sequence, samples, integrand, seed):
    """Errors of 64 x 64 pixels."""
    edge = 64
    y, x, sample = (
        each.ravel() for each in np.meshgrid(np.arange(edge), np.arange(edge), np.arange(samples), indexing="ij")
    )
    # numbers of the set that is a light's point
    values = integrand(*numbers(sequence, sample, y * WIDTH + x, LIGHT + 1, seed)[1].astype(np.float64).T)
    return values.reshape(edge, edge, samples).mean(2)


@pytest.mark.parametrize("samples", [1, 4, 16])
@pytest.mark.parametrize(
    "integrand, mean",
    [(lambda a, b: a * b, 1 / 4), (lambda a, b: (a + 0.3 * b < 0.45) + 0.0, 0.3), (lambda a, b: a**4 + b, 0.7)],
    ids=["product", "edge", "power"],
)
def test_blue_noise_is_fine_grained(integrand, mean, samples):
    """Coarse waves of the error, of 8 pixels and longer, have less than half of the power that they have where pixels
    do not know of each other; all waves together have about as much, for this one net.
    """
    power = {}
    for sequence in ("SOBOL", "BLUE_NOISE"):
        error = np.array([errors(sequence, samples, integrand, seed) - mean for seed in range(4)])
        spectrum = (np.abs(np.fft.fft2(error)) ** 2).mean(0)
        waves = np.fft.fftfreq(64)
        coarse = np.hypot(*np.meshgrid(waves, waves)) <= 1 / 8
        power[sequence] = spectrum[coarse].mean(), (error**2).mean()
    assert power["BLUE_NOISE"][0] < power["SOBOL"][0] / 2
    assert power["BLUE_NOISE"][1] < 2 * power["SOBOL"][1]


def test_sobol_second_dimension_against_direction_numbers():
    """The bit trick gives the textbook's matrix: direction numbers v_k = v_(k-1) ^ (v_(k-1) >> 1)."""

    @wp.kernel(**KERNEL_OPTIONS)
    def second(x: wp.array(dtype=wp.uint32), y: wp.array(dtype=wp.uint32)):
        i = wp.tid()
        y[i] = sobol.reverse_bits(sobol._sobol_second(x[i]))

    index = np.random.default_rng(0).integers(0, 2**32, 500, dtype=np.uint32)
    expected, v = np.zeros_like(index), np.uint32(1 << 31)
    for k in range(32):
        expected ^= np.where(index >> np.uint32(k) & np.uint32(1), v, np.uint32(0)).astype(np.uint32)
        v ^= v >> np.uint32(1)
    y = wp.zeros(len(index), dtype=wp.uint32, device=DEVICE)
    launch(load(second), len(index), [wp.array(index, dtype=wp.uint32, device=DEVICE)], [y])
    np.testing.assert_array_equal(y.numpy(), expected)


def test_philox_known_answers():
    """The reference vectors of Random123."""

    @wp.kernel(**KERNEL_OPTIONS)
    def run(counter: wp.array(dtype=wp.vec4ui), key: wp.array(dtype=wp.vec2ui), out: wp.array(dtype=wp.vec4ui)):
        i = wp.tid()
        out[i] = philox(counter[i], key[i])

    counters = [[0] * 4, [0xFFFFFFFF] * 4, [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344]]
    keys = [[0] * 2, [0xFFFFFFFF] * 2, [0xA4093822, 0x299F31D0]]
    expected = [
        [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8],
        [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD],
        [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
    ]
    out = wp.zeros(3, dtype=wp.vec4ui, device=DEVICE)
    arrays = [
        wp.array(np.array(a, np.uint32), dtype=d, device=DEVICE) for a, d in ((counters, wp.vec4ui), (keys, wp.vec2ui))
    ]
    launch(load(run), 3, arrays, [out])
    np.testing.assert_array_equal(out.numpy(), np.array(expected, np.uint32))


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_numbers_are_uniform_and_below_one(sequence):
    """Moments over many pixels, where all sequences are random."""
    samples, pixels = np.meshgrid(np.arange(64), np.arange(4096))
    one, two = numbers(sequence, samples, pixels)
    for values in (one, two[:, 0], two[:, 1]):
        values = values.astype(np.float64)
        assert values.min() >= 0 and values.max() <= 1 - 2.0**-24
        sigma = 1 / np.sqrt(values.size)
        for power in (1, 2, 3):
            assert np.mean(values**power) == pytest.approx(1 / (power + 1), abs=4 * 0.3 * sigma)
        counts = np.bincount((values * 256).astype(int), minlength=256)
        if sequence == "INDEPENDENT":
            assert ((counts - values.size / 256) ** 2 / (values.size / 256)).sum() == pytest.approx(
                255, abs=5 * np.sqrt(510)
            )


def test_owen_scrambling_integrates_better():
    """A smooth integrand: the variance over pixels of 64-sample means falls far below the independent one."""
    samples, pixels = np.meshgrid(np.arange(64), np.arange(1024))
    variance = {}
    for sequence in SEQUENCES:
        _, two = numbers(sequence, samples, pixels)
        means = np.sin(two.astype(np.float64) * [2.0, 1.0]).prod(1).reshape(1024, 64).mean(1)
        exact = (1 - math.cos(2)) / 2 * (1 - math.cos(1))
        assert means.mean() == pytest.approx(exact, abs=4 * means.std() / 32)
        variance[sequence] = means.var()
    assert max(variance["SOBOL"], variance["BLUE_NOISE"]) < 0.01 * variance["INDEPENDENT"]


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_pixels_seeds_and_dimensions_are_independent(sequence):
    """No correlation between neighbours, seeds or dimension sets, within five standard errors."""
    count = 20_000
    pixels = np.arange(count)
    base = numbers(sequence, 3, pixels)[1][:, 0]
    others = {
        "next pixel": numbers(sequence, 3, pixels + 1)[1][:, 0],
        "pixel above": numbers(sequence, 3, pixels + 1920)[1][:, 0],
        "next seed": numbers(sequence, 3, pixels, seed=1)[1][:, 0],
        "second number": numbers(sequence, 3, pixels)[1][:, 1],
        "next bounce": numbers(sequence, 3, pixels, LIGHT + DIMENSIONS_PER_BOUNCE)[1][:, 0],
    }
    sets = (FILTER, LENS, BSDF, ROULETTE, TEXTURE)
    others |= {f"set {d}": numbers(sequence, 3, pixels, d)[1][:, 0] for d in sets}
    if sequence == "INDEPENDENT":  # samples of the others keep apart from each other
        others["next sample"] = numbers(sequence, 4, pixels)[1][:, 0]
    for name, values in others.items():
        assert abs(np.corrcoef(base, values)[0, 1]) < 5 / np.sqrt(count), name
    # within one pixel, sets are padded against each other: pairs across sets fill the square evenly
    samples = np.arange(4096)
    a, b = numbers(sequence, samples, 5, LIGHT)[1][:, 0], numbers(sequence, samples, 5, BSDF)[1][:, 0]
    counts = np.histogram2d(a, b, 16, [[0, 1], [0, 1]])[0]
    assert ((counts - 16) ** 2 / 16).sum() < 255 + 6 * np.sqrt(510)


def test_numbers_depend_on_their_key_alone():
    """The same numbers whatever else is computed in the launch, and no two pixels alike."""
    for sequence in SEQUENCES:
        whole = numbers(sequence, np.arange(100), 77)[1]
        np.testing.assert_array_equal(whole[40:60], numbers(sequence, np.arange(40, 60), 77)[1])
        first = numbers(sequence, 0, np.arange(50_000))[1]
        assert len(np.unique(first, axis=0)) > 49_990
    with pytest.raises(ValueError, match="HALTON"):
        make_sampler("HALTON")
