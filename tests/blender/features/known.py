"""Quick features, and those of them that are known to be out of bounds."""

import pytest

from tests.blender.features.registry import chosen_features
from tests.support.running.shares import marks_of

# known failures with their figures: expected to fail, and reported when they no longer do
KNOWN: dict[str, str] = {}


# quick ones whose pictures take ten seconds and more, and what tests them in a plain run
THOROUGH = {
    "Motion blur: a volume by its velocities": "tests/renders/volumes/grids/test_flows.py",
    "OpenVDB object: cubic interpolation": "tests/renders/volumes/grids/test_cubic_grids.py",
}


def quick_parameters(kind: str) -> list:
    """The quick features of one kind, as parameters of a test."""
    marks = {name: [pytest.mark.xfail(reason=reason, strict=True)] for name, reason in KNOWN.items()}
    marks |= {name: [*marks.get(name, ()), *marks_of(False)] for name in THOROUGH}
    found = [each for each in chosen_features(quick=True) if each.kind == kind]
    return [pytest.param(each, id=each.name, marks=marks.get(each.name, [])) for each in found]
