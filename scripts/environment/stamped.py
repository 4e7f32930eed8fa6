"""Run a script, and write a stamp once it has done its work: python stamped.py STAMP TEXT SCRIPT ARGUMENT...

In one process, so that whoever ends it ends the work. The script has a function `main(arguments)`, which returns the
exit code. What fails, or is ended before, leaves the stamp as it was.
"""

import runpy
import sys
from pathlib import Path


def main() -> int:
    """The script's exit code."""
    stamp, text, script, *arguments = sys.argv[1:]
    sys.argv = [script, *arguments]
    sys.path[0] = str(Path(script).parent)
    code = runpy.run_path(script)["main"](arguments)
    if not code:
        write_stamp(Path(stamp), text)
    return code


def write_stamp(stamp: Path, text: str) -> None:
    """Say in the file `stamp` that what `text` stands for was made."""
    new = stamp.with_name(f"{stamp.name}.new")
    new.write_text(text + "\n", encoding="ascii")
    new.replace(stamp)


if __name__ == "__main__":
    sys.exit(main())
