"""One version, in one place: the package, the extension's manifest and the statistics have it from there."""

import re
import tomllib

import package
import pytest

from raybatch_addon.core.measure.statistics import versions
from raybatch_addon.core.version import VERSION


def test_the_version_stands_in_one_place():
    assert package.project_version() == VERSION == versions()["raybatch"]
    project = tomllib.loads((package.ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" not in project["project"] and project["project"]["dynamic"] == ["version"]
    attribute = project["tool"]["setuptools"]["dynamic"]["version"]["attr"]
    assert attribute == package.VERSION_FILE.removesuffix(".py").replace("/", ".") + ".VERSION"
    manifest = tomllib.loads((package.ROOT / package.MANIFEST).read_text(encoding="utf-8"))
    assert "version" not in manifest, "it is filled in where a zip is built"


def test_a_missing_version_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(package, "ROOT", tmp_path)
    (tmp_path / package.VERSION_FILE).parent.mkdir(parents=True)
    (tmp_path / package.VERSION_FILE).write_text("", encoding="utf-8")
    with pytest.raises(package.PackageError, match=r"version.py says no version"):
        package.project_version()


def test_the_changelog_begins_with_this_version():
    text = (package.ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^## (\S+)", text, re.MULTILINE)[1] == VERSION
