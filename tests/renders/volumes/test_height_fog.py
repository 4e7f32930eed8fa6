"""Fog that thins out with height over a floor, in a world of one colour, against a Monte Carlo of it in float64."""

import dataclasses

import numpy as np
import pytest

from raybatch_addon.core.programs.builder import ProgramBuilder, Value
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.description import Frame, Volume
from raybatch_addon.core.settings.settings import RenderSettings
from tests.renders.volumes.test_volumes import color, in_box, medium
from tests.support import scenes

pytestmark = pytest.mark.usefixtures("general_kernels")

EYE, TARGET, HALF_WIDTH = np.array([0, -4.5, 2.0]), np.array([0, 0, 0.9]), 0.36
TOP, DENSITY, SIZE, WORLD = 1.5, 0.1, 16.0, 0.3  # the fog ends at TOP [m], below which it is DENSITY per metre denser
FOG, FLOOR = np.array([0.9, 0.8, 0.7]), np.array([0.5, 0.4, 0.3])
SCATTERINGS = 4


def free_flights(origin, direction, slope, rng) -> np.ndarray:
    """Distances to where light scatters, infinite where it comes through; the density is `slope` (TOP - z)."""
    sought = rng.exponential(size=len(origin)) / slope
    below, fall = TOP - origin[:, 2], direction[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        before = np.where(below < 0, np.where(fall < 0, below / fall, np.inf), 0.0)
        below = np.maximum(below, 0)
        # the integral of below - fall t is what was sought
        root = below**2 - 2 * fall * sought
        length = np.where(root >= 0, 2 * sought / (below + np.sqrt(np.maximum(root, 0))), np.inf)
    return before + length


def reference(samples: int, channel: int, rng) -> np.ndarray:
    """Radiance along random rays of the camera, one sample each: float64, shape [samples]."""
    forward = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    place = HALF_WIDTH * (2 * rng.random((2, samples)) - 1)
    direction = forward + place[0, :, None] * right + place[1, :, None] * np.cross(right, forward)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin, weight, number = np.repeat(EYE[None], samples, 0), np.ones(samples), np.arange(samples)
    found = np.zeros(samples)
    for _ in range(SCATTERINGS + 1):
        flight = free_flights(origin, direction, DENSITY * FOG[channel], rng)
        with np.errstate(divide="ignore"):
            to_floor = np.where(direction[:, 2] != 0, -origin[:, 2] / direction[:, 2], np.inf)
        at = origin + np.where(np.isfinite(to_floor), to_floor, 0)[:, None] * direction
        on_floor = (to_floor > 1e-9) & (np.abs(at[:, :2]) < SIZE / 2).all(1) & (to_floor < flight)
        leaves = ~on_floor & np.isinf(flight)
        found[number[leaves]] = WORLD * weight[leaves]
        u, phi = rng.random(len(origin)), 2 * np.pi * rng.random(len(origin))
        cosine = np.where(on_floor, np.where(direction[:, 2] < 0, 1, -1) * np.sqrt(1 - u), 2 * u - 1)
        sine = np.sqrt(1 - cosine**2)
        moved = origin + np.where(np.isfinite(flight), flight, 0)[:, None] * direction
        origin = np.where(on_floor[:, None], at, moved)
        direction = np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], 1)
        origin[on_floor, 2] = np.sign(cosine[on_floor]) * 1e-12
        weight = weight * np.where(on_floor, FLOOR[channel], 1.0)
        origin, direction, weight, number = (each[~leaves] for each in (origin, direction, weight, number))
    return found


def test_fog_by_height_is_that_of_a_monte_carlo_in_float64(session):
    builder = ProgramBuilder()
    height = builder.value("separate_xyz", builder.value("volume_position", 0))[2]
    below = builder.value("math", int(MathOperation.SUBTRACT), False, TOP, height, 0.0)
    there = builder.value("math", int(MathOperation.MAXIMUM), False, below, 0.0, 0.0)
    density = builder.value("math", int(MathOperation.MULTIPLY), False, there, DENSITY, 0.0)
    weight = builder.value("multiply_colors", Value.of(tuple(FOG.tolist())), builder.value("splat", density))
    builder.closure("volume_henyey_greenstein", weight, 0.0)
    view = scenes.camera(eye=EYE, target=TARGET, half_width=HALF_WIDTH)
    floor = scenes.diffuse(tuple(FLOOR.tolist()))
    made = scenes.scene(
        [(scenes.plane(size=SIZE), scenes.IDENTITY, floor)],
        world=WORLD,
        frame=Frame(16, 16),
        view=view,
        lights=in_box(medium(1.0)).lights,
    )
    made = dataclasses.replace(made, world=dataclasses.replace(made.world, volume=Volume(program=builder.finish())))
    settings = RenderSettings(sample_count=256, bounce_max=SCATTERINGS - 1, roulette_bounce=100)
    ours = np.array([color(session.render(made, settings.replace(seed=seed))).mean((0, 1)) for seed in range(8)])
    for channel in range(3):
        exact = reference(1 << 20, channel, np.random.default_rng(channel))
        error = np.hypot(exact.std() / np.sqrt(exact.size), ours[:, channel].std(ddof=1) / np.sqrt(len(ours)))
        assert error < 1.2e-3 * exact.mean()
        assert abs(ours[:, channel].mean() - exact.mean()) < 5 * error
