"""Compiled kernels as the extension ships them, made once a clone."""

from pathlib import Path

from lib.shipped_kernels import make_kernels

from raybatch_addon.core.device.shipped import LEVELS
from raybatch_addon.core.files import sole_owner
from tests.support.command_line import ROOT

KEPT = ROOT / "build" / "kernels"  # as `package.py` keeps them
LOWEST = list(LEVELS)[-1]  # the least like native instructions; other levels are a minute of compiling each


def make_lowest(folder: Path) -> None:
    """Write all that is shipped for the lowest level to `folder`; other processes that want it too wait meanwhile."""
    with sole_owner(KEPT / ".making"):
        make_kernels(folder, KEPT, targets=[LOWEST])
