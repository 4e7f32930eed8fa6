"""How a command ends: errors in one line on standard error, exit codes, and folders left as they were."""

from __future__ import annotations

import argparse
import difflib
import sys
from collections.abc import Callable, Collection
from typing import Any, NoReturn

from lib.output import OutputFolders, own_standard_output
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.settings.settings import close_names

ERROR, REFUSED, STOPPED = 1, 3, 130  # exit codes: 130 is that of an interrupt (128 + SIGINT)


class UsageError(RayBatchError):
    """Arguments that do not go together."""


class RefusedError(RayBatchError):
    """Something that was not done because it would have lacked what it may not lack."""


class CommandParser(argparse.ArgumentParser):
    """A parser whose errors are one line, and say what an unknown option may have meant."""

    def __init__(self, *, settings: Collection[str] = (), **options: Any) -> None:
        """`settings`: names that --set knows."""
        super().__init__(**options)
        self._settings = settings

    def error(self, message: str) -> NoReturn:
        """Print `message`, and exit with 2."""
        words = message.partition("unrecognized arguments: ")[2].split(" ")
        unknown = next((each.partition("=")[0] for each in words if each.startswith("--")), "")
        if unknown:
            options = [each for action in self._actions for each in action.option_strings]
            close = [f"--set {each}=VALUE" for each in close_names(unknown.lstrip("-"), self._settings)]
            close = difflib.get_close_matches(unknown, options, n=1, cutoff=0.8) or close
            message = f"there is no option {unknown}" + (f": did you mean {close[0]}?" if close else "")
        self.exit(2, f"{self.prog}: error: {message}{'' if message.endswith('?') else ';'} --help lists all options\n")


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


def first_line(error: BaseException) -> str:
    """The first thing that Blender's message says, without its `Error:`."""
    lines = [line.removeprefix("Error:").strip() for line in str(error).splitlines()]
    return next((line for line in lines if line), type(error).__name__)


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
