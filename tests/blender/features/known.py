"""Quick features, and which of them are known to be out of bounds."""

from collections.abc import Iterator

import pytest

from .registry import chosen_features

# With their figures: expected to fail, and told when they no longer do
KNOWN: dict[str, str] = {}


def quick_parameters(kind: str) -> Iterator:
    """The quick features of one kind, as parameters of a test."""
    for each in chosen_features(quick=True):
        if each.kind == kind:
            marks = [pytest.mark.xfail(reason=KNOWN[each.name], strict=True)] if each.name in KNOWN else []
            yield pytest.param(each, id=each.name, marks=marks)
