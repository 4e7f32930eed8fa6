"""One version, in one place: package, extension, statistics and files have it from the extension's manifest."""

import re
import subprocess
import sys
import tomllib

import package
import pytest

from raybatch_addon.core.measure.statistics import versions
from raybatch_addon.core.version import VERSION


def test_the_version_stands_in_one_place():
    assert package.project_version() == VERSION == versions()["raybatch"]
    project = tomllib.loads((package.ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" not in project["project"] and project["project"]["dynamic"] == ["version"]
    assert project["tool"]["setuptools"]["dynamic"]["version"]["attr"] == "raybatch_addon.core.version.VERSION"


def test_an_extension_has_the_version_of_its_own_manifest(tmp_path):
    core = tmp_path / "raybatch" / "core"
    core.mkdir(parents=True)
    (core / "version.py").write_text((package.ROOT / "raybatch_addon/core/version.py").read_text())
    (tmp_path / "raybatch/blender_manifest.toml").write_text('id = "raybatch"\nversion = "7.8.9"\n')
    code = "import version; print(version.VERSION)"
    done = subprocess.run([sys.executable, "-c", code], cwd=core, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "7.8.9"


def test_a_missing_version_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(package, "ROOT", tmp_path)
    (tmp_path / package.MANIFEST).write_text('id = "raybatch"\n', encoding="utf-8")
    with pytest.raises(package.PackageError, match=r"manifest.toml says no version"):
        package.project_version()


def test_the_changelog_begins_with_this_version():
    text = (package.ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^## (\S+)", text, re.MULTILINE)[1] == VERSION
