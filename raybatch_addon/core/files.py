"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Iterator
from pathlib import Path

_numbers = itertools.count()


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to: when the block ends that file becomes `path`, when it fails nothing is left.

    Errors of the file system (`OSError`) are raised as they are. The name ends as that of `path`, for writers that look
    at it, and no other thread or process gets the same one.
    """
    temporary = path.with_name(f".{os.getpid()}.{next(_numbers)}.{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        with contextlib.suppress(OSError):  # it became `path`, or was never made
            temporary.unlink()
