"""Ticks of logarithmic axes with plain numbers: 0.02, 0.05, 0.1, as many as do not touch. Needs matplotlib."""

from __future__ import annotations

import math

from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

# What is labelled of each decade, from more to less
CHOICES = ((1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8), (1, 1.5, 2, 3, 5, 7), (1, 2, 3, 5), (1, 2, 5), (1, 3), (1,))


def plain_ticks(axis, room: float) -> None:
    """Give an axis such as `place.xaxis` plain numbers, `room` of its length apart or more; call it when all is
    drawn.
    """
    low, high = sorted(axis.get_view_interval())
    axis.set_major_locator(FixedLocator(ticks(low, high, room)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: tick_text(value)))
    axis.set_minor_formatter(NullFormatter())


def ticks(low: float, high: float, room: float) -> list[float]:
    """Round numbers from `low` to `high`, both above 0, with `room` of the way between neighbours."""
    length = math.log10(high / low)
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    for each in CHOICES:
        gap = min(math.log10(b / a) for a, b in zip(each, (*each[1:], 10), strict=True))
        if gap >= room * length:
            return _within(low, high, [m * 10.0**d for d in range(first, last + 1) for m in each])
    step = math.ceil(room * length)
    return _within(low, high, [10.0**d for d in range(first, last + 1) if d % step == 0])


def _within(low: float, high: float, values: list[float]) -> list[float]:
    slack = 1 + 1e-9
    return [value for value in values if low / slack <= value <= high * slack]


def tick_text(value: float) -> str:
    """Without an exponent from 0.001 to 99999."""
    if 1e-3 * (1 - 1e-9) <= value < 1e5:
        return f"{value:.6g}"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    power, mantissa = f"10$^{{{int(exponent)}}}$", mantissa.removesuffix(".0")
    return power if mantissa == "1" else f"{mantissa}·{power}"
