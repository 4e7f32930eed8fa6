"""The quick features against Cycles; scripts/parity.py compares all of them."""

import pytest

bpy = pytest.importorskip("bpy")
if bpy.app.version < (5, 2):
    pytest.skip("features are compared with the Cycles of Blender 5.2", allow_module_level=True)

import numpy as np  # noqa: E402
from blender.features.compare import Picture, figures_of  # noqa: E402
from blender.features.known import KNOWN  # noqa: E402
from blender.features.registry import FAMILIES, all_features, chosen_features  # noqa: E402
from blender.features.runner import run_picture, run_sheet, sheets  # noqa: E402

QUICK = chosen_features(quick=True)


def _parameters(kind):
    for each in QUICK:
        if each.kind == kind:
            marks = [pytest.mark.xfail(reason=KNOWN[each.name], strict=True)] if each.name in KNOWN else []
            yield pytest.param(each, id=each.name, marks=marks)


@pytest.fixture(scope="module")
def node_results(addon, tmp_path_factory):
    """Results of a feature's whole sheet, rendered when the first of them is asked for."""
    found = {}

    def result_of(feature):
        if feature.name not in found:
            sheet = next(sheet for sheet in sheets([each for each in QUICK if each.kind == "node"]) if feature in sheet)
            found.update({result.feature.name: result for result in run_sheet(sheet, tmp_path_factory.mktemp("sheet"))})
        return found[feature.name]

    return result_of


@pytest.mark.parametrize("feature", _parameters("node"))
def test_nodes_alone(feature, node_results):
    result = node_results(feature)
    assert result.ok, result.text()


@pytest.mark.parametrize("feature", _parameters("picture"))
def test_pictures(feature, addon, tmp_path):
    result = run_picture(feature, tmp_path)
    print(result.text())
    assert result.ok, result.text()


def test_what_is_known_to_fail_is_there():
    assert set(KNOWN) <= {each.name for each in QUICK}


def test_every_family_has_features_and_names_lead_to_them():
    assert {each.family for each in all_features()} == set(FAMILIES)
    assert [each.name for each in chosen_features(["Magic Texture"])] == ["Magic Texture"]
    assert {each.family for each in chosen_features(["World"])} == {"World"}
    with pytest.raises(LookupError, match="nothing of that name"):
        chosen_features(["nothing of that name"])


def _picture(mean, noise, seed):
    random = np.random.default_rng(seed)
    return Picture(*(mean + noise * random.standard_normal(mean.shape) for _ in range(2)))


def test_noise_is_taken_away_and_differences_are_not():
    mean = np.full((64, 64, 3), 0.5) + np.linspace(0, 0.5, 64)[None, :, None]
    same = figures_of(_picture(mean, 0.1, 1), _picture(mean, 0.2, 2))
    assert abs(same.rel_mse) < 4 * same.rel_mse_noise and same.mean_error < 4 * same.noise and np.abs(same.deviations).max() < 4
    brighter = figures_of(_picture(1.02 * mean, 0.1, 1), _picture(mean, 0.2, 2))
    assert abs(brighter.mean_error - 0.02) < 4 * brighter.noise and np.abs(brighter.deviations).min() > 4
    # a pattern that leaves the mean as it is
    wavy = figures_of(_picture(mean * (1 + 0.1 * (-1) ** np.arange(64)[:, None, None]), 0.1, 1), _picture(mean, 0.2, 2))
    assert abs(wavy.rel_mse - 0.01 * np.mean(mean**2 / (mean**2 + 1e-2))) < 4 * wavy.rel_mse_noise
