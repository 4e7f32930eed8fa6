"""Looks at the noise: the sample counts after which pixels may end their sampling. Pure policy, without a device."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...settings.settings import RenderSettings

# Samples before the first look: LEAST / noise_threshold^EXPONENT, which is 64 for a threshold of 0.01. The lower the
# noise that a pixel is held to, the more samples show what it is.
LEAST, EXPONENT = 16.0, 0.3
# Looks while the sample count doubles. A pixel gets up to 1 / LOOKS_AN_OCTAVE more samples than it needs, and each look
# ends a round
LOOKS_AN_OCTAVE = 2


@dataclass(frozen=True)
class Looks:
    """Sample counts that follow from the settings alone; all are even, so that both halves have as many samples."""

    first: int

    @staticmethod
    def of(settings: RenderSettings) -> Looks | None:
        """None where no pixel can end before the others."""
        if not settings.is_adaptive or settings.noise_threshold == 0.0:
            return None
        least = settings.adaptive_samples_min or LEAST / settings.noise_threshold**EXPONENT
        return Looks(_even(least))

    def after(self, samples: int) -> int:
        """The first look after more than `samples` samples."""
        if samples < self.first:
            return self.first
        octave = self.first
        while 2 * octave <= samples:
            octave *= 2
        parts = (_even(octave * (1 + k / LOOKS_AN_OCTAVE)) for k in range(1, LOOKS_AN_OCTAVE + 1))
        return next(count for count in parts if count > samples)

    def last_until(self, samples: int) -> int:
        """The last look after no more than `samples` samples; 0: there is none."""
        look = 0
        while (following := self.after(look)) <= samples:
            look = following
        return look


def _even(samples: float) -> int:
    """The least even number that is not below `samples`."""
    return 2 * math.ceil(samples / 2)
