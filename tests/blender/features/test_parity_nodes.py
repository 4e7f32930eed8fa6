"""The quick features that are nodes alone against Cycles; scripts/parity.py compares all of them."""

import pytest

bpy = pytest.importorskip("bpy")
if bpy.app.version < (5, 2):
    pytest.skip("features are compared with the Cycles of Blender 5.2", allow_module_level=True)

from tests.blender.features.known import quick_parameters
from tests.blender.features.registry import chosen_features
from tests.blender.features.runner import run_sheet, sheets

SHEETS = sheets([each for each in chosen_features(quick=True) if each.kind == "node"])


@pytest.fixture(scope="module")
def result_of(addon, tmp_path_factory):
    """The result of a feature; its whole sheet is rendered at the first request."""
    found = {}

    def result(feature):
        if feature.name not in found:
            sheet = next(sheet for sheet in SHEETS if feature in sheet)
            found.update({each.feature.name: each for each in run_sheet(sheet, tmp_path_factory.mktemp("sheet"))})
        return found[feature.name]

    return result


@pytest.mark.parametrize("feature", quick_parameters("node"))
def test_nodes_alone(feature, result_of):
    result = result_of(feature)
    assert result.ok, result.text()
