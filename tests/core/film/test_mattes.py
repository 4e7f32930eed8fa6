"""Mattes are exact sums by identity, whatever the order of samples and wherever they are kept."""

import dataclasses
from collections import Counter

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.device.kernel import KERNEL_OPTIONS
from raybatch_addon.core.film import mattes as mattes_module
from raybatch_addon.core.film.mattes import SLOTS, WEIGHT_SCALE, MatteEntry, Mattes, MatteTile, mattes_on_device
from raybatch_addon.core.scene.cryptomatte import matte_identity, murmur_hash
from raybatch_addon.core.scene.description import Closure, ClosureKind, Frame
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.under_test import DEVICE

NAMES = ("CryptoObject00", "CryptoObject01", "CryptoAsset00")
KINDS, PIXELS = 2, 5


@wp.kernel(**KERNEL_OPTIONS)
def add_samples(
    tile: MatteTile,
    kind: wp.array(dtype=int),
    pixel: wp.array(dtype=int),
    identity: wp.array(dtype=int),
    weight: wp.array(dtype=float),
):
    i = wp.tid()
    mattes_module.add_matte(tile, kind[i], pixel[i], identity[i], weight[i])


def summed(samples: np.ndarray, tile=None, left: Mattes | None = None) -> Mattes:
    """`samples`: columns kind, pixel, identity, weight; added to what is there."""
    device = wp.get_device(DEVICE)
    if tile is None:
        tile, left = mattes_on_device(Mattes(), PIXELS, KINDS, device)
    tile.aside = wp.zeros(len(samples), dtype=MatteEntry, device=device)
    tile.aside_count = wp.zeros(1, dtype=int, device=device)
    columns = [wp.array(samples[:, i].astype(np.int32), dtype=int, device=device) for i in range(3)]
    weights = wp.array(samples[:, 3].astype(np.float32), dtype=float, device=device)
    wp.launch(add_samples, len(samples), [tile, *columns, weights], device=device)
    aside = Mattes.of_entries(tile.aside.numpy()[: tile.aside_count.numpy()[0]])
    return Mattes.of_device(tile).plus(left).plus(aside)


def drawn(count: int, seed: int = 1) -> np.ndarray:
    """Samples of more identities than a pixel has slots for."""
    rng = np.random.default_rng(seed)
    return np.stack(
        [
            rng.integers(0, KINDS, count),
            rng.integers(0, PIXELS, count),
            rng.integers(1, 3 * SLOTS, count) * 1_000_003,
            rng.random(count).astype(np.float32),
        ],
        axis=1,
    )


def counted(samples: np.ndarray) -> dict:
    found = Counter()
    for kind, pixel, identity, weight in samples.tolist():
        found[int(pixel) * KINDS + int(kind), int(identity)] += int(np.float32(weight) * WEIGHT_SCALE)
    return dict(found)


def as_dict(mattes: Mattes) -> dict:
    return {
        (cell, identity): weight
        for cell, identity, weight in zip(mattes.cell.tolist(), mattes.identity.tolist(), mattes.weight.tolist())
    }


def assert_equal(first: Mattes, second: Mattes):
    for field in dataclasses.fields(Mattes):
        assert np.array_equal(getattr(first, field.name), getattr(second, field.name)), field.name


def test_sums_are_exact_in_any_order_and_partition():
    samples = drawn(600)
    whole = summed(samples)
    assert as_dict(whole) == counted(samples) and len(whole.cell) > KINDS * PIXELS * SLOTS
    for seed in (2, 3):
        shuffled = np.random.default_rng(seed).permutation(samples)
        assert_equal(summed(shuffled), whole)
        assert_equal(summed(shuffled[:170]).plus(summed(shuffled[170:])), whole)


def test_samples_are_added_to_what_comes_back_to_a_device():
    samples = drawn(600)
    tile, left = mattes_on_device(summed(samples[:250]), PIXELS, KINDS, wp.get_device(DEVICE))
    assert len(left.cell)
    assert_equal(summed(samples[250:], tile, left), summed(samples))


def test_parts_of_a_region_are_its_pixels():
    whole = summed(drawn(300))
    pixels = np.array([4, 1, 2])
    part, rest = whole.part(pixels, KINDS), whole.part(np.array([0, 3]), KINDS)
    assert set((part.cell // KINDS).tolist()) == {0, 1, 2}
    assert_equal(part.moved(pixels, KINDS).plus(rest.moved(np.array([0, 3]), KINDS)), whole)


def test_passes_show_the_identities_with_most_weight():
    one = int(WEIGHT_SCALE)
    mattes = Mattes().plus(
        Mattes(np.array([0, 0, 0, 3]), np.array([7, 5, 9, 8], np.uint32), np.array([one, 3 * one, 2 * one, 4 * one]))
    )
    passes = {name: values.reshape(-1, 4) for name, values in mattes.passes(NAMES, np.array([8, 4])).items()}
    identity = np.array([5, 9, 7, 8], np.uint32).view(np.float32)
    assert passes["CryptoObject00"].tolist() == [[identity[0], 3 / 8, identity[1], 2 / 8], [0, 0, 0, 0]]
    assert passes["CryptoObject01"].tolist() == [[identity[2], 1 / 8, 0, 0], [0, 0, 0, 0]]
    assert passes["CryptoAsset00"].tolist() == [[0, 0, 0, 0], [identity[3], 1, 0, 0]]


@pytest.mark.parametrize(("name", "value"), [("", 0), ("hello", 0x248BFA47), ("hello, world", 0x149BBB7F)])
def test_hashes_are_murmurs(name, value):
    assert murmur_hash(name) == value


def test_identities_are_finite_numbers():
    bits = np.array([matte_identity(f"object {i}") for i in range(3000)], np.uint32)
    numbers = bits.view(np.float32)
    assert np.all(np.isfinite(numbers) & (np.abs(numbers) >= np.finfo(np.float32).tiny)) and len(set(bits)) == 3000


@pytest.mark.usefixtures("general_kernels")
def test_a_veil_has_its_share_of_the_pixel(session):
    """Whatever is sampled behind it: a sample weighs what the surface does not let through."""
    veil = scenes.material(
        Closure(ClosureKind.TRANSPARENT, (0.75,) * 3), Closure(ClosureKind.DIFFUSE, (0.1,) * 3), name="veil"
    )
    view = scenes.camera(eye=(0, 0, 3), up=(0, 1, 0), half_width=0.1)
    objects = [
        (scenes.plane(size=8), scenes.translation(0, 0, -i), surface)
        for i, surface in enumerate((veil, scenes.diffuse()))
    ]
    frame = Frame(4, 4, passes=("Combined", "CryptoObject00", "CryptoMaterial00"))
    scene = scenes.scene(objects, view=view, frame=frame, world=0.5)
    settings = RenderSettings(sample_count=64, bounce_max=2)
    film = session.render(scene, settings)
    shown = film.passes["CryptoObject00"].reshape(-1, 4)
    identities = {matte_identity(f"object {i}"): i for i in (0, 1)}
    share = np.zeros((16, 2))
    for half in (0, 2):
        number = [identities[bits] for bits in shown[:, half].copy().view(np.uint32).tolist()]
        share[np.arange(16), number] = shown[:, half + 1]
    assert np.all(share[:, 0] == 0.25)
    assert share[:, 1].mean() == pytest.approx(0.75, abs=4 * share[:, 1].std() / 4)
    for change in (dict(tile_size=3), dict(ray_count=7), dict(sample_order="PIXEL_FIRST")):
        other = session.render(scene, settings.replace(**change))
        assert all(np.array_equal(other.passes[name], film.passes[name]) for name in film.passes), change
