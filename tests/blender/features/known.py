"""Quick features, and those of them that are known to be out of bounds."""

import pytest

from tests.blender.features.registry import chosen_features

# known failures with their figures: expected to fail, and reported when they no longer do
KNOWN: dict[str, str] = {}


def quick_parameters(kind: str) -> list:
    """The quick features of one kind, as parameters of a test."""
    marks = {name: [pytest.mark.xfail(reason=reason, strict=True)] for name, reason in KNOWN.items()}
    found = [each for each in chosen_features(quick=True) if each.kind == kind]
    return [pytest.param(each, id=each.name, marks=marks.get(each.name, [])) for each in found]
