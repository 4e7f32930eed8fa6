"""The library: its wheel is built, installed apart from this checkout, and used as its page says."""

import inspect
import os
import re
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from package import project_version

from raybatch_addon.core.cluster import calls
from raybatch_addon.core.cluster.connection import PACKAGES
from raybatch_addon.core.scene.archive import save_scene
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes
from tests.support.command_line import ROOT

PAGE, CLUSTER_PAGE = ROOT / "docs/library.md", ROOT / "docs/cluster.md"
CORE = ROOT / "raybatch_addon/core"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts/wheel.py"), "--out", str(folder)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    (path,) = folder.glob("raybatch-*.whl")
    assert done.stdout.strip() == str(path)
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """A folder with the installed library."""
    folder = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(folder)]
    subprocess.run([*pip, str(wheel)], check=True, stdin=subprocess.DEVNULL)
    return folder


def run_installed(installed, folder, *command):
    """Run Python where the library is, and this checkout is not."""
    variables = {**os.environ, "PYTHONPATH": str(installed)}
    done = subprocess.run([sys.executable, "-P", *command], capture_output=True, text=True, env=variables, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_wheel_has_all_files_of_the_core(wheel):
    with zipfile.ZipFile(wheel) as file:
        names = {name for name in file.namelist() if name.startswith("raybatch/")}
        (about,) = (file.read(name).decode() for name in file.namelist() if name.endswith("METADATA"))
    there = {
        f"raybatch/{path.relative_to(CORE).as_posix()}"
        for path in CORE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert names == there and "raybatch/py.typed" in names
    assert re.search(r"^Requires-Dist: warp-lang<1.20,>=1.19$", about, re.MULTILINE)


def test_it_is_installed_for_clusters_as_the_page_and_errors_say(wheel, tmp_path):
    (tmp_path / "dist").symlink_to(wheel.parent)
    (tmp_path / "bin").mkdir()
    pip = tmp_path / "bin/pip"
    pip.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m pip "$@" --dry-run --no-deps --no-index\n')
    pip.chmod(0o755)
    variables = {**os.environ, "PATH": f"{pip.parent}{os.pathsep}{os.environ['PATH']}"}
    said = [CLUSTER_PAGE.read_text(encoding="utf-8"), PACKAGES, inspect.getsource(calls)]
    for text in said:
        (command,) = re.findall(r'pip install "\$.*\[cluster\]"', text)
        done = subprocess.run(command, shell=True, capture_output=True, text=True, env=variables, cwd=tmp_path)
        assert done.returncode == 0 and f"Would install raybatch-{project_version()}" in done.stdout, done.stderr


def test_its_names_are_there(installed, tmp_path):
    code = "import raybatch, sys; print(raybatch.__file__, [n for n in raybatch.__all__ if not hasattr(raybatch, n)])"
    code += "; assert not any(each.startswith('raybatch_addon') for each in sys.modules); print(raybatch.VERSION)"
    where, version = run_installed(installed, tmp_path, "-c", code).splitlines()
    assert where == f"{installed / 'raybatch/__init__.py'} []"
    assert f"-{version}-" in next(installed.parent.rglob("raybatch-*.whl")).name


def test_ten_lines_render_a_saved_scene(installed, session, tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    scene = scenes.scene([(scenes.sphere(), scenes.IDENTITY, scenes.diffuse((0.8, 0.5, 0.3)))], world=1.0)
    save_scene(tmp_path / "scene.npz", scene, RenderSettings(bounce_max=2))
    (tmp_path / "ten.py").write_text(code)
    said = run_installed(installed, tmp_path, "ten.py", "scene.npz", "film.npz")
    assert re.fullmatch(r"[\d.e-]+ seconds\n", said)
    expected = session.render(scene, RenderSettings(bounce_max=2, sample_count=16)).passes
    with np.load(tmp_path / "film.npz") as film:
        assert sorted(film) == sorted(expected)
        if session.device.is_cpu:  # AUTO may be another device
            assert all(np.array_equal(film[name], expected[name]) for name in expected)


def test_its_page_is_true(installed, tmp_path):
    code = "import doctest, sys; failed, tried = doctest.testfile(sys.argv[1], False); assert tried > 10 and not failed"
    run_installed(installed, tmp_path, "-c", code, str(PAGE))
