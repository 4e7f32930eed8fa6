"""The quick features that are whole pictures against Cycles; scripts/parity.py compares all of them."""

import pytest

bpy = pytest.importorskip("bpy")
if bpy.app.version < (5, 2):
    pytest.skip("features are compared with the Cycles of Blender 5.2", allow_module_level=True)

from tests.blender.features.known import quick_parameters
from tests.blender.features.registry import SAMPLES
from tests.blender.features.runner import run_picture


@pytest.mark.parametrize("feature", quick_parameters("picture"))
def test_pictures(feature, addon, tmp_path, examples):
    """A plain run begins with fewer samples; where these do not decide, more are taken."""
    result = run_picture(feature, tmp_path, examples(feature.samples or SAMPLES))
    print(result.text())
    assert result.ok, result.text()
