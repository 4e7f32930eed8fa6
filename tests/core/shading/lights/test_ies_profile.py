"""Photometric files: parsing, completion of symmetric profiles, and messages about unusable files."""

import numpy as np
import pytest

from raybatch_addon.core.shading.lights.ies_profile import CANDELA, ProfileError, parse_profile


def file(horizontal, vertical, candela, kind=1, tilt="NONE", factor=1.0, ballast="1.0 1.0 100") -> str:
    """A file of these angles; `candela` by horizontal angle."""
    numbers = " ".join(str(value) for row in candela for value in row)
    head = f"1 1000 {factor} {len(vertical)} {len(horizontal)} {kind} 2 0 0 0\n{ballast}"
    angles = "\n".join(" ".join(map(str, each)) for each in (vertical, horizontal))
    return f"IESNA:LM-63-1995\n[TEST] one\nTILT={tilt}\n{head}\n{angles}\n{numbers}\n"


def degrees(angles) -> list[float]:
    return np.rad2deg(np.asarray(angles, np.float64)).round(3).tolist()


def test_a_file_that_says_everything_is_taken_as_it_is():
    profile = parse_profile(
        file([0, 180, 360], [0, 90, 180], [[1, 2, 3], [4, 5, 6], [1, 2, 3]], factor=2.0, ballast="0.5 3 100")
    )
    assert degrees(profile.horizontal) == [0, 180, 360] and degrees(profile.vertical) == [0, 90, 180]
    assert profile.intensity == pytest.approx(3 * CANDELA * np.array([[1, 2, 3], [4, 5, 6], [1, 2, 3]]), rel=1e-6)
    assert profile.table.dtype == np.float32 and len(profile.table) == 3 + 3 + 9


@pytest.mark.parametrize(
    "horizontal, expected, rows",
    (
        ([0], [0, 360], [0, 0]),
        ([0, 45, 90], [0, 45, 90, 135, 180, 225, 270, 315, 360], [0, 1, 2, 1, 0, 1, 2, 1, 0]),
        ([0, 90, 180], [0, 90, 180, 270, 360], [0, 1, 2, 1, 0]),
        ([90, 180, 270], [0, 90, 180, 270, 360], [0, 1, 2, 1, 0]),
        ([0, 120, 240], [0, 120, 240, 360], [0, 1, 2, 0]),
        ([0, 100, 200], [0, 100, 200], [0, 1, 2]),  # an ambiguous file
    ),
)
def test_what_is_symmetric_is_completed(horizontal, expected, rows):
    profile = parse_profile(file(horizontal, [0, 90], [[i, 10 + i] for i in range(len(horizontal))]))
    assert degrees(profile.horizontal) == expected
    assert profile.intensity[:, 0] == pytest.approx(CANDELA * np.array(rows), rel=1e-6)


def test_types_a_and_b_become_type_c():
    b = parse_profile(file([0, 90], [0, 45, 90], [[0, 1, 2], [3, 4, 5]], kind=2))
    assert degrees(b.horizontal) == [0, 45, 90, 135, 180] and degrees(b.vertical) == [0, 90, 180]
    assert b.intensity / CANDELA == pytest.approx(
        np.array([[5, 2, 5], [4, 1, 4], [3, 0, 3], [4, 1, 4], [5, 2, 5]]), rel=1e-6
    )
    b = parse_profile(file([-90, 90], [-90, 0, 90], [[0, 1, 2], [3, 4, 5]], kind=2))
    assert degrees(b.horizontal) == [0, 90, 180] and degrees(b.vertical) == [0, 180]
    a = parse_profile(file([0, 90], [-90, 0, 90], [[0, 1, 2], [3, 4, 5]], kind=3))
    assert degrees(a.horizontal) == [90, 180, 270] and degrees(a.vertical) == [0, 90, 180]
    assert a.intensity[:, 0] / CANDELA == pytest.approx(np.array([3, 0, 3]), rel=1e-6)


def test_tilt_is_skipped_and_commas_and_line_ends_are_space():
    text = file([0], [0, 90], [[7, 8]]).replace("TILT=NONE\n", "TILT=INCLUDE\n1\n3\n0 45 90\n1 .9 .8\n")
    profile = parse_profile(text.replace(" ", ", ").replace("\n", "\r\n"))
    assert profile.intensity[0] == pytest.approx(CANDELA * np.array([7, 8]), rel=1e-6)


GOOD = file([0, 90], [0, 45, 90], [[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize(
    "text, why",
    (
        ("", "TILT="),
        ("TILT=NONE", "TILT="),
        ("x\nTILT=NONE", "ends at the line"),
        (GOOD[:-6], "cut short"),
        (GOOD.replace("0 1 2 3", "0 1 two 3"), "no number where one must be, in line 8"),
        (file([0], [0, 90], [[7, 8]], kind=4), "photometric type is 4"),
        (file([], [0, 90], []), "0 horizontal angles"),
        (GOOD.replace(" 3 2 1 ", " 1000000000 1000000000 1 "), "angles"),
        (GOOD.replace(" 3 2 1 ", " -3 2 1 "), "-3 vertical"),
        (GOOD.replace("3 4 5", "3 4 1e60"), "not finite"),
        (GOOD.replace("3 4 5", "3 4 nan"), "no number"),
        ("x\nTILT=INCLUDE 1 999999999999 0", "cut short"),
        ("\0" * 100, "TILT="),
    ),
)
def test_what_cannot_be_used_says_why(text, why):
    with pytest.raises(ProfileError, match=why):
        parse_profile(text)
