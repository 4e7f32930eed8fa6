"""The extension's zip: its contents, and that a Blender without Warp renders with it."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

import package
import pytest
from lib.shipped_kernels import can_be_made
from PIL import Image

from raybatch_addon.core.version import VERSION
from tests.support.command_line import ROOT, run_python, run_script
from tests.support.running.general_kernels import put_general_kernels
from tests.support.running.kernels_to_ship import LOWEST, make_lowest

pytest.importorskip("bpy")
ZIP_BYTES_MOST = 220 << 20
KERNELS = "extensions/.user/user_default/raybatch/kernels"  # the extension's own, below Blender's files
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the zip for Linux is installed")

# Installs the zip sys.argv[1] into a fresh Blender where Warp can come from the extension's wheel only, and renders to
# sys.argv[2]
INSTALL_AND_RENDER = """
import importlib.machinery
import sys

class WarpFromTheExtensionOnly:
    def find_spec(self, name, path=None, target=None):
        if name != "warp":
            return None
        elsewhere = [entry for entry in sys.path if not entry.startswith(sys.prefix)]
        spec = importlib.machinery.PathFinder.find_spec(name, elsewhere)
        if spec is None:
            raise ModuleNotFoundError("no module named warp (hidden by a test)", name="warp")
        return spec

sys.meta_path.insert(0, WarpFromTheExtensionOnly())
sys.path = [entry for entry in sys.path if entry not in ("", sys.argv[3])]  # nor the add-on from the clone
import bpy

def available(name):
    try:
        __import__(name)
    except ModuleNotFoundError:
        return False
    return True

assert not available("warp") and not available("raybatch_addon")
install = bpy.ops.extensions.package_install_files
assert install(filepath=sys.argv[1], repo="user_default", enable_on_install=True) == {"FINISHED"}
import warp
assert "/extensions/.local/" in warp.__file__, warp.__file__
assert "bl_ext.user_default.raybatch" in bpy.context.preferences.addons
engines = [c for c in bpy.types.RenderEngine.__subclasses__() if getattr(c, "bl_idname", "") == "RAYBATCH"]
assert [c.__module__ for c in engines] == ["bl_ext.user_default.raybatch.engine"]

scene = bpy.context.scene
scene.render.engine = "RAYBATCH"
scene.render.resolution_x = scene.render.resolution_y = 32
scene.raybatch.device, scene.raybatch.sample_count = "cpu", 2
scene.render.filepath = sys.argv[2]
bpy.ops.render.render(write_still=True)
reports = sys.modules["bl_ext.user_default.raybatch.blender.reports"]
print("tier", [each["auto"].get("kernel_tier") for each in reports.last().statistics.values()])
print("left", reports.last().errors, reports.last().warnings)
assert not available("raybatch_addon")

bpy.ops.preferences.addon_disable(module="bl_ext.user_default.raybatch")
assert not hasattr(bpy.types.Scene, "raybatch")
"""


# Renders the same start-up scene with the add-on of the clone
RENDER_FROM_THE_CLONE = """
import sys
sys.path.insert(0, sys.argv[2])
import bpy
import raybatch_addon
raybatch_addon.register()
scene = bpy.context.scene
scene.render.engine = "RAYBATCH"
scene.render.resolution_x = scene.render.resolution_y = 32
scene.raybatch.device, scene.raybatch.sample_count = "cpu", 2
scene.render.filepath = sys.argv[1]
bpy.ops.render.render(write_still=True)
"""


def offline() -> bool:
    """Whether pip reaches no index at all: a wheel that cannot be downloaded is then not the project's fault."""
    command = [
        sys.executable,
        "-m",
        "pip",
        "download",
        "--quiet",
        "--no-deps",
        "--no-input",
        "--disable-pip-version-check",
        "--no-cache-dir",
    ]
    with tempfile.TemporaryDirectory() as folder:
        return subprocess.run([*command, "--dest", folder, "tqdm"], capture_output=True).returncode != 0


def linux_zip_of(out: Path, *arguments: str) -> Path:
    """The zip for Linux in `out`; wheels and kernels are kept in the clone, so that they are had once."""
    done = run_script("package.py", "linux-x64", "--out", out, *arguments)
    if done.returncode == 3 and offline():
        pytest.skip(f"no network, and no wheel kept from before: {done.stderr.strip()}")
    assert done.returncode == 0, done.stderr
    (made,) = out.iterdir()
    assert done.stdout.split() == [str(made)]
    return made


@pytest.fixture(scope="module")
def linux_zip(tmp_path_factory) -> Path:
    """A zip without compiled kernels, as those for other systems are."""
    return linux_zip_of(tmp_path_factory.mktemp("dist"), "--no-kernels")


@pytest.fixture(scope="module")
def zip_with_kernels(tmp_path_factory) -> Path:
    """The zip as users get it, but with kernels for the lowest level alone."""
    if not can_be_made("linux-x64"):
        pytest.skip("kernels are shipped for x86-64")
    make_lowest(tmp_path_factory.mktemp("kernels") / "made")  # which the script finds again
    return linux_zip_of(tmp_path_factory.mktemp("dist"), "--targets", LOWEST)


def installed_in(home: Path, made: Path) -> subprocess.CompletedProcess:
    """The zip `made`, installed into a Blender whose files are in `home`, after a render to `home`/out.png."""
    done = run_python(INSTALL_AND_RENDER, made, home / "out.png", ROOT, **environment_of(home))
    assert done.returncode == 0 and "left [] []" in done.stdout, done.stderr
    return done


def environment_of(home: Path) -> dict:
    """Kernels are kept where the extension keeps them, and chosen as for a user."""
    return {"BLENDER_USER_RESOURCES": home, "RAYBATCH_KERNEL_CACHE": "", "RAYBATCH_KERNEL_TIER": "AUTO"}


@pytest.fixture(scope="module")
def home_without(linux_zip, tmp_path_factory) -> Path:
    """A Blender with the zip without kernels, which has rendered.

    Of the general kernels, which take minutes to compile, the extension's folder holds all but one, as after a render
    before.
    """
    home = tmp_path_factory.mktemp("without")
    kept = home / KERNELS
    for module in put_general_kernels(kept):
        if "generate_kernel" in module.name:
            shutil.rmtree(module)
    assert "shipped for" not in installed_in(home, linux_zip).stdout
    return home


@pytest.mark.thorough  # compiles the general kernels for each kind of processor
def test_the_zip_with_kernels_is_not_too_large(zip_with_kernels):
    assert zip_with_kernels.stat().st_size < ZIP_BYTES_MOST
    with zipfile.ZipFile(zip_with_kernels) as file:
        index = json.loads(file.read("kernels/index.json"))
        names = set(file.namelist())
    assert list(index["targets"]) == [LOWEST] and any("raybatch_general" in name for name in index["modules"])
    for entry in index["modules"].values():
        for target, binary in entry["binaries"].items():
            assert f"kernels/{target}/{binary['file']}" in names


@pytest.mark.thorough  # as above
def test_the_first_render_uses_the_shipped_kernels(zip_with_kernels, home_without, tmp_path):
    """Kernels are read where they are installed, a folder that nobody need write; nothing that shades is compiled, and
    the picture is that of a zip without any.
    """
    assert "shipped for x86-64" in installed_in(tmp_path, zip_with_kernels).stdout
    pictures = []
    for home in (tmp_path, home_without):
        kept = list((home / KERNELS).rglob("wp_*.o"))
        assert bool(kept) == (home == home_without), kept
        pictures.append(Image.open(home / "out.png").tobytes())
    assert pictures[0] == pictures[1]


def test_the_zip_holds_the_addon_its_manifest_and_warp(linux_zip):
    with zipfile.ZipFile(linux_zip) as file:
        names = set(file.namelist())
        manifest = tomllib.loads(file.read("blender_manifest.toml").decode())
    assert manifest["id"] == "raybatch" and manifest["version"] == VERSION
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"] and "files" in manifest["permissions"]
    assert manifest["platforms"] == ["linux-x64"]
    (wheel,) = manifest["wheels"]
    assert wheel.removeprefix("./") in names and "manylinux" in wheel and "warp_lang" in wheel
    addon = ROOT / "raybatch_addon"
    sources = {str(path.relative_to(addon)) for kind in ("*.py", "*.h", "*.npz") for path in addon.rglob(kind)}
    assert "__init__.py" in sources and sources <= names
    assert "LICENSE" in names
    assert not [name for name in names if "__pycache__" in name or name.endswith(".pyc")]


def test_blender_without_warp_renders_with_it(home_without, tmp_path):
    again, environment = tmp_path / "again.png", environment_of(home_without)
    picture = Image.open(home_without / "out.png")
    assert picture.size == (32, 32)
    assert len(picture.convert("RGB").getcolors()) > 10  # the cube of the start-up file, lit
    folder = home_without / KERNELS
    kernels = {path: path.stat().st_mtime_ns for path in folder.rglob("wp_*") if path.is_file()}
    assert kernels

    # kernels that one compiled serve the other: nothing is compiled again, nor elsewhere
    done = run_python(RENDER_FROM_THE_CLONE, again, ROOT, **environment, XDG_CACHE_HOME=tmp_path / "cache")
    assert done.returncode == 0, done.stderr
    assert Image.open(again).tobytes() == picture.tobytes()
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("wp_*") if path.is_file()} == kernels
    assert not list(tmp_path.glob("cache/**/wp_*"))

    # either way of adding it lets Python end by itself
    for add in (
        "import addon_utils; addon_utils.enable('bl_ext.user_default.raybatch')",
        "import sys; sys.path.insert(0, sys.argv[1]); import raybatch_addon; raybatch_addon.register()",
    ):
        code = f"import bpy; {add}; assert hasattr(bpy.types.Scene, 'raybatch')"
        variables = {**os.environ, **{name: str(value) for name, value in environment.items()}}
        done = subprocess.run(
            [sys.executable, "-c", code, ROOT], capture_output=True, text=True, env=variables, timeout=60
        )
        assert done.returncode == 0 and "Error" not in done.stderr, done.stderr


@pytest.mark.parametrize("platform", package.PIP_PLATFORMS)
def test_each_platform_gets_its_own_manifest(platform, tmp_path):
    wheel = tmp_path / f"warp_lang-1-py3-none-{package.PIP_PLATFORMS[platform]}.whl"
    wheel.write_bytes(b"wheel")
    package.stage(tmp_path / "stage", platform, wheel)
    manifest = tomllib.loads((tmp_path / "stage/blender_manifest.toml").read_text())
    assert manifest["platforms"] == [platform] and manifest["version"] == VERSION
    assert manifest["wheels"] == [f"./wheels/{wheel.name}"]
    assert (tmp_path / "stage" / manifest["wheels"][0]).read_bytes() == b"wheel"
    assert manifest["permissions"]["files"]


def test_a_refused_manifest_leaves_no_zip(tmp_path, monkeypatch):
    wheel = tmp_path / "warp_lang-1-py3-none-any.whl"
    wheel.write_bytes(b"wheel")
    monkeypatch.setattr(package, "fetch_wheel", lambda platform, folder: wheel)
    original = package.stage

    def stage_without_licence(folder, platform, wheel):
        original(folder, platform, wheel)
        manifest = folder / package.MANIFEST
        manifest.write_text(manifest.read_text().replace("license = ", "# license = "))

    monkeypatch.setattr(package, "stage", stage_without_licence)
    with pytest.raises(package.PackageError, match="license"):
        package.build("linux-x64", tmp_path / "dist", tmp_path / "build" / "wheels")
    assert list((tmp_path / "dist").iterdir()) == []


@pytest.mark.skipif(not can_be_made("linux-x64"), reason="kernels are compiled on Linux")
def test_kernels_that_nobody_finds_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("RAYBATCH_OPTIMISATION", "1")
    with pytest.raises(package.PackageError, match="RAYBATCH_OPTIMISATION is set"):
        package.add_kernels(tmp_path, "linux-x64", tmp_path / "kept", "")
    assert not (tmp_path / "kernels").exists()


def test_an_unknown_platform_is_named():
    done = run_script("package.py", "amiga")
    assert done.returncode == 2
    assert "amiga" in done.stderr.strip().splitlines()[-1]
