"""One version: the statistics', which is the package's too, and the one that the extension's manifest repeats."""

import tomllib

import package
import pytest

from raybatch_addon.core.measure.statistics import VERSION


def test_the_manifest_and_the_package_have_the_version_of_the_statistics():
    assert package.project_version() == VERSION
    project = tomllib.loads((package.ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" not in project["project"] and project["project"]["dynamic"] == ["version"]
    attribute = project["tool"]["setuptools"]["dynamic"]["version"]["attr"]
    assert attribute == package.STATISTICS.removesuffix(".py").replace("/", ".") + ".VERSION"


def test_versions_that_differ_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr(package, "ROOT", tmp_path)
    (tmp_path / package.STATISTICS).parent.mkdir(parents=True)
    (tmp_path / package.STATISTICS).write_text('VERSION = "1.2.3"  # as it is\n', encoding="utf-8")
    (tmp_path / package.MANIFEST).write_text('version = "1.2.4"\n', encoding="utf-8")
    with pytest.raises(package.PackageError, match=r"manifest.toml says 1.2.4; .*statistics.py says 1.2.3"):
        package.project_version()
