"""A folder of kernels that is damaged, read-only or full, or that two processes fill at once, spoils no render."""

import errno
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import warp as wp

from raybatch_addon.core.ahead.process import CompileProcess
from raybatch_addon.core.device import kept_kernels
from raybatch_addon.core.device.compiler import CompileStoppedError
from raybatch_addon.core.device.devices import is_compiled, load_module, loaded_modules, start_warp
from raybatch_addon.core.device.kept_kernels import KernelFiles
from raybatch_addon.core.device.notes import take_notes
from raybatch_addon.core.errors import DeviceError
from tests.core.device.small_kernels import (
    files_of,
    forget,
    in_small_disk,
    keep_in,
    process_command,
    put_header,
    small_kernel,
    works,
)
from tests.support.running.shares import each_of

ON_LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="file systems are mounted as on Linux")


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A folder for kernels without any."""
    keep_in(tmp_path, monkeypatch)
    take_notes()
    return tmp_path


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def overwrite(path: Path) -> None:
    path.write_bytes(bytes(range(1, 251)) * 10)


def blank_the_middle(path: Path) -> None:
    """Loaded as it is, such an object ended the process."""
    data = bytearray(path.read_bytes())
    data[len(data) // 3 : len(data) * 2 // 3] = bytes(len(data) * 2 // 3 - len(data) // 3)
    path.write_bytes(data)


@pytest.mark.parametrize("damage", each_of(3, [truncate, empty, overwrite, blank_the_middle]))
@pytest.mark.parametrize("which", ["binary", "meta", "sum"])
def test_what_is_damaged_is_compiled_anew(folder, damage, which):
    kernel = small_kernel()
    assert works(kernel) and take_notes() == []
    path = getattr(files_of(kernel), which)
    before = path.read_bytes()
    damage(path)
    forget(kernel)
    assert not is_compiled(kernel, wp.get_device("cpu"))
    assert works(kernel)
    (note,) = take_notes()
    assert str(files_of(kernel).binary) in note and "was damaged; it is compiled anew" in note
    assert path.read_bytes() == before
    forget(kernel)
    assert is_compiled(kernel, wp.get_device("cpu")) and works(kernel) and take_notes() == []


@pytest.mark.parametrize("damage", [truncate, empty, overwrite])
def test_what_has_no_sums_has_to_be_complete(folder, damage):
    kernel = small_kernel()
    assert works(kernel)
    files = files_of(kernel)
    files.sum.unlink()
    forget(kernel)
    assert is_compiled(kernel, wp.get_device("cpu")), "an earlier version wrote none"
    damage(files.binary)
    assert not is_compiled(kernel, wp.get_device("cpu"))
    assert works(kernel)


def test_a_damaged_header_is_parsed_again(folder):
    headers = list(folder.glob("header-*/*.pch"))  # of other kinds of kernels too, where earlier tests had some
    for each in headers:
        overwrite(each)
    assert works(small_kernel()) and works(small_kernel())
    assert sorted(folder.glob("header-*/*.pch")) == sorted(headers)
    assert len([each for each in headers if each.stat().st_size > 1 << 20]) == 1


def of_another_processor(files: KernelFiles) -> Path:
    return files.binary.with_name(f"{files.binary.name.split('.')[0]}.cpu00000000.o")


def of_other_code(files: KernelFiles) -> Path:
    """The kernel as if its code had another hash."""
    name = files.binary.parent.name
    other = f"{name.rpartition('_')[0]}_0000000"
    return files.binary.parent.with_name(other) / files.binary.name.replace(name, other)


def of_another_version(files: KernelFiles) -> Path:
    """The same kernel by another version of Warp."""
    return files.binary.parents[2] / "0.0.1" / files.binary.parent.name / files.binary.name


@pytest.mark.parametrize("place", [of_another_processor, of_other_code, of_another_version])
def test_kernels_of_another_version_or_processor_are_left_alone(tmp_path, monkeypatch, place):
    keep_in(tmp_path / wp.config.version, monkeypatch)
    start_warp(tmp_path)  # which chooses the folder of its version
    take_notes()
    kernel = small_kernel()
    files = files_of(kernel)
    other = place(files)
    assert tmp_path in other.parents and other != files.binary and works(kernel)
    other.parent.mkdir(parents=True, exist_ok=True)
    data = files.binary.read_bytes()
    if other.parent != files.meta.parent:
        shutil.copy(files.meta, other.parent)
    files.binary.rename(other)
    forget(kernel)
    assert not is_compiled(kernel, wp.get_device("cpu"))
    assert works(kernel) and take_notes() == []
    assert other.read_bytes() == data and files.binary.exists()


def test_what_nobody_waits_for_is_not_loaded(folder):
    kernel, device = small_kernel(), wp.get_device("cpu")
    assert works(kernel)
    forget(kernel)
    with pytest.raises(CompileStoppedError):
        load_module(kernel, device, lambda: True)
    assert loaded_modules([kernel], device) is None and works(kernel)


@ON_LINUX
@pytest.mark.usefixtures("cpu_compiler")
def test_a_read_only_folder_is_said_and_kernels_are_compiled_elsewhere(tmp_path):
    done = in_small_disk(process_command(tmp_path), tmp_path, "size=1m", f'mount -o remount,ro "{tmp_path}"')
    assert done.stderr == ""
    works, note = done.stdout.splitlines()
    assert works == "works" and str(tmp_path) in note
    assert "(Read-only file system); make room in it and make it writable, or set RAYBATCH_KERNEL_CACHE" in note


@ON_LINUX
@pytest.mark.usefixtures("cpu_compiler")
def test_a_read_only_folder_with_kernels_serves(tmp_path):
    kernels, seen = tmp_path / "kernels", tmp_path / "seen"
    put_header(kernels / wp.config.version)
    assert subprocess.run(process_command(kernels), capture_output=True, text=True).stdout == "works\n"
    seen.mkdir()
    copy = f'cp -r "{kernels}/." "{seen}" && mount -o remount,ro "{seen}"'
    done = in_small_disk(process_command(seen), seen, "size=64m", copy)
    assert (done.stdout, done.stderr) == ("works\n", "")


@ON_LINUX
@pytest.mark.parametrize("size", ["16k", "2m", "4556k"])  # no room for a folder, for the header, for kernels
@pytest.mark.usefixtures("cpu_compiler")
def test_a_full_disk_is_said_and_kernels_are_compiled_elsewhere(tmp_path, size):
    """The compiler ends its process where it cannot write: it must not be this one."""
    done = in_small_disk(process_command(tmp_path), tmp_path, f"size={size}")
    assert done.returncode == 0 and done.stderr == ""
    works, note = done.stdout.splitlines()
    assert works == "works" and f"cannot be kept in {tmp_path}" in note and "(No space left on device)" in note


def test_where_nothing_can_be_written_one_line_says_so(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")

    def refuse(*_arguments, **_options):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(kept_kernels.tempfile, "mkdtemp", refuse)
    monkeypatch.setattr(kept_kernels, "_spare", None)
    with pytest.raises(DeviceError, match=r"cannot be kept in .*file/kernels.* \(Not a directory\); make room in it"):
        start_warp(blocked / "kernels")


def test_a_process_that_compiles_for_others_fails_where_it_cannot_keep(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    process = CompileProcess("cpu", blocked / "kernels")
    process.wait()
    assert process.complaint().startswith(f"DeviceError: compiled kernels cannot be kept in {blocked / 'kernels'}")


@pytest.mark.usefixtures("cpu_compiler")
def test_the_spare_folder_goes_with_the_process(tmp_path):
    blocked, temporary = tmp_path / "file", tmp_path / "temporary"
    blocked.write_text("not a folder")
    temporary.mkdir()
    done = subprocess.run(
        ["env", f"TMPDIR={temporary}", *process_command(blocked / "kernels")], capture_output=True, text=True
    )
    works, note = done.stdout.splitlines()
    assert works == "works" and str(blocked) in note
    assert list(temporary.iterdir()) == []


@pytest.mark.usefixtures("cpu_compiler")
def test_two_processes_fill_an_empty_folder_at_once(tmp_path):
    both = [subprocess.Popen(process_command(tmp_path), stdout=-1, stderr=-1, text=True) for _ in range(2)]
    assert [process.communicate(timeout=300) for process in both] == [("works\n", "")] * 2
    (versions,) = tmp_path.iterdir()
    names = [path.name for path in versions.iterdir() if path.name.startswith("wp_")]
    assert len(names) == 2 and not [name for name in names if "_p" in name.removeprefix("wp_add_number")]
    for each in versions.glob("wp_*"):
        assert {path.suffix for path in each.iterdir()} == {".o", ".meta", ".sum", ".cpp"}


def test_what_was_begun_and_abandoned_is_swept(folder):
    old, new = folder / "wp_a_1234567_p77_t88", folder / "wp_b_1234567_p77_t88"
    for each in (old, new):
        each.mkdir()
        (each / "wp.cpp").write_text("half")
    os.utime(old, (time.time() - 1e6,) * 2)
    kept_kernels.remove_abandoned()
    assert not old.exists() and new.exists()
