"""The repository of extensions: made by Blender's own command, and refused with the reason where it cannot be."""

import json
import sys

import pytest
from extension import repository

from raybatch_addon.core.version import VERSION
from tests.support.command_line import run_script

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a shell script stands for Blender")
# Writes the list of the zips that are there, as `blender --command extension server-generate` does
BLENDER = """#!{python}
import json, pathlib, sys
assert sys.argv[1:5] == ["--command", "extension", "server-generate", "--repo-dir"], sys.argv
folder = pathlib.Path(sys.argv[5])
data = [{{"archive_url": f"./{{each.name}}"}} for each in sorted(folder.glob("*.zip"))[{first}:]]
(folder / "index.json").write_text(json.dumps({{"version": "v1", "data": data}}))
"""


@pytest.fixture
def packages(tmp_path):
    folder = tmp_path / "packages"
    folder.mkdir()
    for name in (f"raybatch-{VERSION}-linux_x64.zip", f"raybatch-{VERSION}-windows_x64.zip", "raybatch-0.0.1-old.zip"):
        (folder / name).write_bytes(name.encode())
    return folder


def blender(folder, text):
    program = folder / "blender"
    program.write_text(text, encoding="utf-8")
    program.chmod(0o755)
    return str(program)


def make(tmp_path, packages, program):
    folders = ["--packages", str(packages), "--out", str(tmp_path / "repository")]
    return run_script("extension/repository.py", "--blender", program, *folders)


def test_zips_of_this_version_are_listed(tmp_path, packages):
    old = tmp_path / "repository"
    old.mkdir()
    (old / "raybatch-0.0.1-linux_x64.zip").write_bytes(b"")
    done = make(tmp_path, packages, blender(tmp_path, BLENDER.format(python=sys.executable, first=0)))
    assert done.returncode == 0, done.stderr
    listed = json.loads((old / "index.json").read_text(encoding="utf-8"))["data"]
    names = [f"raybatch-{VERSION}-linux_x64.zip", f"raybatch-{VERSION}-windows_x64.zip"]
    assert [each["archive_url"] for each in listed] == [f"./{name}" for name in names]
    assert sorted(each.name for each in old.iterdir()) == sorted(["index.json", *names])


@pytest.mark.parametrize(
    "program, complaint",
    [
        ("/nowhere/blender", "there is no program /nowhere/blender: name Blender's with BLENDER=/path/to/blender"),
        ("#!/bin/sh\necho it is broken >&2\nexit 3\n", "it is broken"),
        (BLENDER.format(python=sys.executable, first=1), f"Blender left raybatch-{VERSION}-linux_x64.zip out of"),
    ],
)
def test_what_went_wrong_is_reported(program, complaint, tmp_path, packages):
    done = make(tmp_path, packages, program if program.startswith("/") else blender(tmp_path, program))
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert done.stderr.startswith("repository.py: error: ") and complaint in done.stderr


def test_there_must_be_zips(tmp_path):
    done = make(tmp_path, tmp_path, blender(tmp_path, BLENDER.format(python=sys.executable, first=0)))
    assert done.returncode == 1 and f"has no zip of version {VERSION}: run `make package` first" in done.stderr


def test_blender_on_the_path_is_found(tmp_path, monkeypatch):
    program = blender(tmp_path, "#!/bin/sh\n")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert repository.find_blender("") == program
    monkeypatch.setenv("PATH", str(tmp_path / "nothing"))
    with pytest.raises(repository.RepositoryError, match="no program blender on PATH"):
        repository.find_blender("")
