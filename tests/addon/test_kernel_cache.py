"""Where compiled kernels are kept."""

import sys

import pytest

from raybatch_addon.blender.kernel_cache import kernel_cache_folder


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A user without anything."""
    for name in ("RAYBATCH_KERNEL_CACHE", "BLENDER_USER_RESOURCES", "BLENDER_USER_EXTENSIONS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


linux_only = pytest.mark.skipif(sys.platform != "linux", reason="the user's folders of other systems are not faked")


def install(extensions, repository="user_default"):
    code = extensions / repository / "raybatch"
    code.mkdir(parents=True)
    (code / "blender_manifest.toml").touch()


@linux_only
def test_without_the_extension_it_is_the_users_cache(home):
    (home / "config/blender/5.2/extensions/user_default/other").mkdir(parents=True)
    assert kernel_cache_folder() == home / "cache/raybatch/kernels"


@linux_only
def test_the_installed_extensions_folder_is_shared_newest_blender_first(home):
    for version in ("4.5", "10.0", "5.2"):
        install(home / "config/blender" / version / "extensions")
    assert kernel_cache_folder() == home / "config/blender/10.0/extensions/.user/user_default/raybatch/kernels"


def test_blenders_own_variables_are_followed(home, monkeypatch):
    install(home / "resources/extensions", "mine")
    install(home / "elsewhere")
    monkeypatch.setenv("BLENDER_USER_RESOURCES", str(home / "resources"))
    assert kernel_cache_folder() == home / "resources/extensions/.user/mine/raybatch/kernels"
    monkeypatch.setenv("BLENDER_USER_EXTENSIONS", str(home / "elsewhere"))
    assert kernel_cache_folder() == home / "elsewhere/.user/user_default/raybatch/kernels"


def test_the_variable_overrides_everything(home, monkeypatch):
    install(home / "config/blender/5.2/extensions")
    monkeypatch.setenv("RAYBATCH_KERNEL_CACHE", str(home / "own"))
    assert kernel_cache_folder() == home / "own"
