"""Arrays that lie in files without names."""

import errno
import gc
import os

import numpy as np
import pytest

from raybatch_addon.core import host_memory
from raybatch_addon.core.errors import OutOfMemoryError
from raybatch_addon.core.host_memory import mapped_empty
from tests.core.bvh.pages.page_files import is_mapped


def test_a_large_array_is_in_a_file_and_a_small_one_is_not(tmp_path, monkeypatch):
    monkeypatch.setattr(host_memory, "MAPPED_LEAST", 1000)
    folder = tmp_path / "made" / "here"
    large, small = mapped_empty((100, 3), np.float32, folder), mapped_empty((83, 3), np.float32, folder)
    assert is_mapped(large) and not is_mapped(small)
    assert large.shape == (100, 3) and large.dtype == np.float32 and type(large) is np.ndarray
    values = np.arange(300, dtype=np.float32).reshape(100, 3)
    large[:] = values
    assert np.array_equal(large, values) and np.array_equal(large[7:9], values[7:9])
    assert not list(folder.iterdir()), "it has no name: nothing is left when the process is killed"
    held = large[50:]
    del large
    gc.collect()
    assert np.array_equal(held, values[50:])


@pytest.mark.parametrize("reserves", [True, False])
def test_no_room_on_the_disk_is_said_before_anything_is_written(tmp_path, monkeypatch, reserves):
    """A page that cannot be written later would end the process."""

    def refuse(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(host_memory, "MAPPED_LEAST", 1000)
    if reserves:
        monkeypatch.setattr(os, "posix_fallocate", refuse, raising=False)
    else:
        monkeypatch.delattr(os, "posix_fallocate", raising=False)
        monkeypatch.setattr(host_memory, "_WRITTEN", 4096)
        assert is_mapped(mapped_empty((10_000,), np.uint8, tmp_path))
        monkeypatch.setattr(os, "write", refuse)
    with pytest.raises(OutOfMemoryError, match=r"2\.00 GB of geometry cannot .* \(No space left .*free some space"):
        mapped_empty((2_000_000, 1000), np.uint8, tmp_path)
