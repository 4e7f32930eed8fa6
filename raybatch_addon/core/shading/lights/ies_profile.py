"""Photometric files (IES LM-63): how much light a lamp sends in every direction, read as Cycles reads them.

LM-63 knows three systems of angles. All are turned into type C: a vertical angle of 0 is down, 180 degrees up;
horizontal angles go once around. Files in the wild keep to the standard loosely, so angles that they leave out are
mirrored or repeated wherever the file shows which.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

# Watts of Blender's lights for a candela: 4 pi over the luminous efficacy of the illuminant D65 [lm/W]
CANDELA = 0.0706650768394
_ANGLES_MOST = 10_000  # most angles of either kind
_VALUES_MOST = 2**22
_CLOSE = 1e-4  # tolerance of angles [degrees]
# Numbers as C's strtod and strtol read them: white space, and then as much as there is of a number
_DECIMAL = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)")
_INTEGER = re.compile(r"\s*([+-]?\d+)")


class ProfileError(ValueError):
    """Error for text that is no usable photometric file; the message says why."""


class PhotometricType(IntEnum):
    """System of angles of a file."""

    C = 1
    B = 2
    A = 3


@dataclass(frozen=True)
class LightProfile:
    """Intensities on a grid of angles, in the system of type C."""

    horizontal: np.ndarray  # [rad], float32, shape [h], h >= 2
    vertical: np.ndarray  # [rad], float32, shape [v]
    intensity: np.ndarray  # [W], float32, shape [h, v]

    @property
    def table(self) -> np.ndarray:
        """The profile in one row: horizontal angles, vertical angles, intensities by horizontal angle; float32."""
        return np.concatenate([self.horizontal, self.vertical, self.intensity.ravel()])


def parse_profile(text: str) -> LightProfile:
    """The profile that a photometric file holds; raises `ProfileError`."""
    reader = _Reader(text.replace(",", " "))
    reader.whole()  # number of lamps
    reader.real()  # lumens of each lamp
    factor = reader.real()
    vertical_count, horizontal_count = reader.whole(), reader.whole()
    kind = reader.whole()
    if kind not in tuple(PhotometricType):
        raise ProfileError(f"its photometric type is {kind}, which is none of 1 (C), 2 (B) and 3 (A)")
    reader.whole()  # unit of the next three
    for _ in range(3):  # size of the lamp
        reader.real()
    factor *= reader.real() * reader.real()  # factors of the ballast
    reader.real()  # power that it takes [W]
    if not (1 <= vertical_count <= _ANGLES_MOST and 1 <= horizontal_count <= _ANGLES_MOST):
        raise ProfileError(f"it has {vertical_count} vertical and {horizontal_count} horizontal angles")
    if vertical_count * horizontal_count > _VALUES_MOST:
        raise ProfileError(f"it has more than {_VALUES_MOST:,} values")
    vertical = np.array([reader.real() for _ in range(vertical_count)], np.float32)
    horizontal = np.array([reader.real() for _ in range(horizontal_count)], np.float32)
    candela = np.array([reader.real() for _ in range(vertical_count * horizontal_count)])
    with np.errstate(over="ignore", invalid="ignore"):
        intensity = (factor * CANDELA * candela).astype(np.float32).reshape(horizontal_count, vertical_count)
    horizontal, vertical, intensity = _OF_TYPE[PhotometricType(kind)](horizontal, vertical, intensity)
    to_radians = np.float32(np.pi) / np.float32(180)
    profile = LightProfile(horizontal * to_radians, vertical * to_radians, intensity)
    if not all(np.isfinite(part).all() for part in (profile.horizontal, profile.vertical, profile.intensity)):
        raise ProfileError("it has numbers that are not finite")
    return profile


class _Reader:
    """Reader of a file's numbers in order, from the block about tilt on."""

    def __init__(self, text: str) -> None:
        self._text = text
        tilt = text.find("\nTILT=")
        if tilt < 0:
            raise ProfileError("it has no line that begins with TILT=")
        if text.startswith("\nTILT=INCLUDE", tilt):
            self._at = tilt + len("\nTILT=INCLUDE")
            self.real()  # orientation of the lamp
            for _ in range(2 * min(max(self.whole(), 0), _ANGLES_MOST)):  # angles and their factors, which are not used
                self.real()
        else:
            self._at = text.find("\n", tilt + 1)
            if self._at < 0:
                raise ProfileError("it ends at the line that begins with TILT=")

    def real(self) -> float:
        """The next number."""
        return float(self._next(_DECIMAL))

    def whole(self) -> int:
        """The next integer; text behind its digits is left for the next number, as in C."""
        return int(self._next(_INTEGER))

    def _next(self, pattern: re.Pattern[str]) -> str:
        found = pattern.match(self._text, self._at)
        if found is None:
            if not self._text[self._at :].strip():
                raise ProfileError("it is cut short")
            raise ProfileError(
                f"it has no number where one must be, in line {self._text.count(chr(10), 0, self._at) + 1}"
            )
        self._at = found.end()
        return found.group(1)


def _close(angle: np.float32, other: float) -> bool:
    return bool(abs(angle - np.float32(other)) < np.float32(_CLOSE))


def _mirrored(angles: np.ndarray, about: float) -> np.ndarray:
    """Angles from the last to the second, mirrored about half of `about`; to be put before `angles`."""
    return np.float32(about) - angles[:0:-1]


def _from_type_c(horizontal: np.ndarray, vertical: np.ndarray, intensity: np.ndarray):
    if _close(horizontal[0], 90):  # the file goes from 90 to 270 degrees
        horizontal = horizontal - np.float32(90)
    if len(horizontal) == 1:  # the same light all around
        return np.array([0, 360], np.float32), vertical, np.repeat(intensity, 2, 0)
    for whole in (90, 180):  # a quarter is mirrored twice, a half once
        if _close(horizontal[-1], whole):
            horizontal = np.concatenate([horizontal, np.float32(2 * whole) - horizontal[-2::-1]])
            intensity = np.concatenate([intensity, intensity[-2::-1]])
    if _close(horizontal[0], 0) and not _close(horizontal[-1], 360):
        gap = np.float32(360) - horizontal[-1]
        # the last angle stands for the first too
        if _close(horizontal[-1] - horizontal[-2], gap) or _close(horizontal[1] - horizontal[0], gap):
            horizontal = np.append(horizontal, np.float32(360))
            intensity = np.concatenate([intensity, intensity[:1]])
    return horizontal, vertical, intensity


def _from_type_b(horizontal: np.ndarray, vertical: np.ndarray, intensity: np.ndarray):
    # the pole lies across: Cycles swaps the two kinds of angles, and leaves it to the user to turn the lamp
    horizontal, vertical, intensity = vertical, horizontal, intensity.T
    right = np.float32(90)
    if _close(horizontal[0], 0):
        horizontal = np.concatenate([_mirrored(horizontal, 90), right + horizontal])
        intensity = np.concatenate([intensity[:0:-1], intensity])
    else:
        horizontal = horizontal + right
    if _close(vertical[0], 0):
        vertical = np.concatenate([_mirrored(vertical, 90), right + vertical])
        intensity = np.concatenate([intensity[:, :0:-1], intensity], 1)
    else:
        vertical = vertical + right
    return horizontal, vertical, intensity


def _from_type_a(horizontal: np.ndarray, vertical: np.ndarray, intensity: np.ndarray):
    # -90 to 90 degrees are 270 to 90 of type C
    straight = np.float32(180)
    turned, values = straight - horizontal[::-1], intensity[::-1]
    if _close(horizontal[0], 0):
        turned = np.concatenate([turned, straight + horizontal[1:]])
        values = np.concatenate([values, intensity[1:]])
    return turned, vertical + np.float32(90), values


_OF_TYPE = {PhotometricType.A: _from_type_a, PhotometricType.B: _from_type_b, PhotometricType.C: _from_type_c}
