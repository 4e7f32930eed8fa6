"""Blender installs from a repository that the script made, and updates from it."""

import functools
import http.server
import os
import subprocess
import sys
import threading

import package
import pytest

from raybatch_addon.core.version import VERSION
from tests.support.command_line import run_python, run_script

pytest.importorskip("bpy")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a shell script stands for Blender")

# Its command `extension`, by the script that Blender itself runs for it
BLENDER = """#!/bin/sh
shift 2
exec {python} {builder} "$@"
"""
INSTALL = """
import sys
import bpy

preferences = bpy.context.preferences
preferences.system.use_online_access = True
repositories = preferences.extensions.repos
for each in [*repositories]:
    repositories.remove(each)
repositories.new(name="RayBatch", module="raybatch_repo", remote_url=sys.argv[1])
operators = bpy.ops.extensions
assert operators.repo_sync(repo_index=0) == {"FINISHED"}
if sys.argv[2] == "install":
    assert operators.package_install(repo_index=0, pkg_id="raybatch", enable_on_install=True) == {"FINISHED"}
else:
    assert operators.package_upgrade_all() == {"FINISHED"}
import addon_utils
bpy.ops.preferences.addon_enable(module="bl_ext.raybatch_repo.raybatch")
print("installed", sys.modules["bl_ext.raybatch_repo.raybatch"].VERSION)
"""
MANIFEST = """schema_version = "1.0.0"
id = "raybatch"
version = "{version}"
name = "RayBatch"
tagline = "Stands for RayBatch in a test"
maintainer = "Nobody"
type = "add-on"
blender_version_min = "4.5.0"
license = ["SPDX:GPL-3.0-or-later"]
"""


def put_package(folder, version, name):
    """A zip of an extension that only knows its `version`."""
    source = folder / f"source-{version}"
    source.mkdir(parents=True)
    (source / "blender_manifest.toml").write_text(MANIFEST.format(version=version), encoding="utf-8")
    code = f"VERSION = {version!r}\ndef register(): pass\ndef unregister(): pass\n"
    (source / "__init__.py").write_text(code, encoding="utf-8")
    packages = folder / f"packages-{version}"
    packages.mkdir()
    command = [sys.executable, package.builder(), "build", "--source-dir", source, "--output-filepath", packages / name]
    subprocess.run([str(each) for each in command], check=True, capture_output=True)
    return packages


def make(tmp_path, version):
    program = tmp_path / "blender"
    program.write_text(BLENDER.format(python=sys.executable, builder=package.builder()), encoding="utf-8")
    program.chmod(0o755)
    packages = put_package(tmp_path, version, f"raybatch-{VERSION}-any.zip")
    folders = ["--packages", str(packages), "--out", str(tmp_path / "repository")]
    done = run_script("extension/repository.py", "--blender", str(program), *folders)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def address(tmp_path):
    """The address of a server of the folder `repository`."""
    (tmp_path / "repository").mkdir()

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Quiet, directory=str(tmp_path / "repository"))
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/index.json"
    server.shutdown()
    server.server_close()


def test_blender_installs_from_it_and_updates(address, tmp_path):
    own = {name: os.environ.get(name, "") for name in ("NO_PROXY", "no_proxy")}
    home = dict(BLENDER_USER_RESOURCES=tmp_path / "user", **{name: f"{value},127.0.0.1" for name, value in own.items()})
    make(tmp_path, "0.9.1")
    done = run_python(INSTALL, address, "install", **home)
    assert "installed 0.9.1" in done.stdout, done.stdout + done.stderr
    make(tmp_path, "0.9.2")
    done = run_python(INSTALL, address, "update", **home)
    assert "installed 0.9.2" in done.stdout, done.stdout + done.stderr
