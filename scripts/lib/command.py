"""How a command ends: errors in one line on standard error, exit codes, and folders left as they were."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from lib.output import OutputFolders, own_standard_output
from raybatch_addon.core.errors import RayBatchError

ERROR, REFUSED, STOPPED = 1, 3, 130  # exit codes: 130 is that of an interrupt (128 + SIGINT)


class UsageError(RayBatchError):
    """Arguments that do not go together."""


class RefusedError(RayBatchError):
    """Something that was not done because it would have lacked what it may not lack."""


def run_command(
    script: str,
    verbose: bool,
    work: Callable[[OutputFolders, Any], int],
    stopped: str = "stopped",
    errors: tuple[type[Exception], ...] = (RayBatchError,),
) -> int:
    """The exit code of `work(folders, standard_output)`, for the command called `script`.

    Standard output is the command's own: what Blender and Warp print there goes to standard error if `verbose`, else
    nowhere. Folders in which nothing was written are removed at the end. `errors` and `stopped` are as in `exit_code`.
    """
    folders = OutputFolders()
    with own_standard_output(verbose) as standard_output:
        try:
            return exit_code(script, lambda: work(folders, standard_output), stopped, errors)
        finally:
            folders.take_back()


def exit_code(
    script: str,
    work: Callable[[], int],
    stopped: str = "stopped",
    errors: tuple[type[Exception], ...] = (RayBatchError,),
) -> int:
    """The exit code of `work()`; `errors` are reported in a line, and an interrupt as `stopped`."""
    try:
        return work()
    except errors as error:
        # the text of a KeyError is its key in quotes
        text = str(error.args[0]) if isinstance(error, LookupError) and error.args else str(error)
        print(f"{script}: error: {' '.join(text.split())}", file=sys.stderr)
        return REFUSED if isinstance(error, RefusedError) else ERROR
    except KeyboardInterrupt:
        print(f"{script}: {stopped}", file=sys.stderr)
        return STOPPED
