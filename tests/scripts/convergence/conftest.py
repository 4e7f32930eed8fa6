"""The parts that tests of scripts/convergence.py share."""

import pytest

from tests.support.convergence_runs import save_lit


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Where references are kept."""
    return tmp_path_factory.mktemp("references")


@pytest.fixture(autouse=True)
def own_folder(kept, monkeypatch):
    """References are kept apart from the user's."""
    monkeypatch.setenv("RAYBATCH_REFERENCES", str(kept))


@pytest.fixture(scope="module")
def lit(tmp_path_factory):
    """A floor under a lamp."""
    return save_lit(tmp_path_factory.mktemp("lit"))
