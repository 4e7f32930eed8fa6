"""Lamps whose light comes from programs: invalid numbers, unusual falloffs, and light that estimates miss."""

from __future__ import annotations

import dataclasses
import math

from raybatch_addon.core.programs.builder import ProgramBuilder, Value
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.scene.description import Light, LightKind
from tests.stability.bench import Bench
from tests.stability.case import Outcome, Sweep, case
from tests.stability.uniform import ROUNDING, STATISTICS, UNSEEN, add_mean, floor_of, point_light
from tests.support import scenes


def _computed(builder: ProgramBuilder, operation: MathOperation, a: Value | float, b: Value | float) -> Value:
    return builder.value("math", int(operation), 0, a, b, 0.0)


def shining(lamp: Light, build) -> Light:
    """`lamp`, multiplied by the number or vector that `build(builder)` returns."""
    builder = ProgramBuilder()
    value = build(builder)
    builder.closure("emission", value if value.width == 3 else builder.value("combine_xyz", value, value, value))
    return dataclasses.replace(lamp, program=builder.finish())


@case(
    "lamps whose programs give no number",
    "lights",
    "Lamps of every kind whose programs give infinity, NaN and negative numbers in their channels, beside one that "
    "gives 1: they are dark.",
    f"{STATISTICS}; 64 roundings.",
    quick=True,
)
def no_number(bench: Bench) -> Outcome:
    """Sweep over kinds."""

    def broken(builder: ProgramBuilder) -> Value:
        far = _computed(
            builder,
            MathOperation.MULTIPLY,
            _computed(builder, MathOperation.ADD, builder.value("light_path")[7], 1.0),
            1e30,
        )
        infinite = _computed(builder, MathOperation.MULTIPLY, far, far)
        nothing = _computed(builder, MathOperation.SUBTRACT, infinite, infinite)
        return builder.value(
            "combine_xyz", infinite, nothing, _computed(builder, MathOperation.MULTIPLY, infinite, -1.0)
        )

    above = scenes.translation(0.2, 0.1, 1.5)
    lamps = [
        Light(kind.name, kind, above, (1.0,) * 3, radius=radius, angle=1.0, soft_falloff=False, visibility=UNSEEN)
        for kind in LightKind
        for radius in (0.0, 0.3)
    ]
    good = shining(
        point_light((0, 0, 1)),
        lambda builder: _computed(builder, MathOperation.POWER, builder.value("light_path")[6], 0.0),
    )
    picture = bench.render(floor_of(good, *(shining(lamp, broken) for lamp in lamps)), sample_count=256)
    sweep = Sweep()
    for channel in range(3):
        add_mean(sweep, picture[..., channel:], 1 / math.pi, ROUNDING, f"channel {channel}")
    return sweep.outcome()


@case(
    "light falloff at distances of 1e-6 to 1e9",
    "lights",
    "A point lamp whose program lets its light fall with the square of the distance, with the distance, or not at "
    "all, with and without smoothing of 1: intensity d^(n - 2) d^2 / (1 + d^2) of a white floor at the distance d.",
    "64 roundings, and 1e-6: of the distance and the cosine over the seen spot, whose radius is 1e-4 d.",
    quick=True,
)
def falloff(bench: Bench) -> Outcome:
    """Sweep over distances and outputs."""
    sweep = Sweep()
    for d in (1e-6, 1e-3, 1.0, 1e3, 1e9):
        for output in range(3):
            for smooth in (0.0, 1.0):
                lamp = shining(
                    point_light((0, 0, d)), lambda builder: builder.value("light_falloff", 1.0, smooth)[output]
                )
                scene = floor_of(lamp, size=200 * d, eye=(0.0, -0.1 * d, 100 * d), half_width=1e-6)
                expected = d ** (output - 2) / math.pi * (d * d / (1 + d * d) if smooth else 1.0)
                add_mean(
                    sweep,
                    bench.render(scene, sample_count=1),
                    expected,
                    ROUNDING + 1e-6,
                    f"{output} at {d:g}, smooth {smooth:g}",
                )
    return sweep.outcome()


@case(
    "a lamp that shines where nobody looked",
    "lights",
    "Two point lamps of intensity 1: one shines everywhere, the program of the other gives 50 within 0.6 degrees of "
    "straight down, which the points that estimate its brightness miss; the floor below it has both.",
    f"{STATISTICS}; 64 roundings.",
)
def unseen_brightness(bench: Bench) -> Outcome:
    """One picture."""

    def beam(builder: ProgramBuilder) -> Value:
        down = builder.value("separate_xyz", builder.value("normals")[2])[2]
        inside = _computed(builder, MathOperation.LESS_THAN, down, -math.cos(math.radians(0.6)))
        return _computed(builder, MathOperation.MULTIPLY, inside, 50.0)

    everywhere = point_light((0, 0, 1))
    picture = bench.render(floor_of(everywhere, shining(everywhere, beam)), sample_count=16384)
    sweep = Sweep()
    add_mean(sweep, picture, 51 / math.pi, ROUNDING)
    return sweep.outcome()
