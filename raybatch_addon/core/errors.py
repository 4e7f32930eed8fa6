"""Errors that a user can mend. Their messages name the thing at fault and what to do about it."""

from collections.abc import Callable


class RayBatchError(Exception):
    """Base of every error that is shown to the user as one clear line, without a traceback."""


class SettingsError(RayBatchError, ValueError):
    """A setting that does not exist, or a value outside its range."""


class SceneError(RayBatchError, ValueError):
    """A scene that cannot be rendered as it is."""


class DeviceError(RayBatchError, RuntimeError):
    """A device that does not exist, or that failed."""


class BuildCancelledError(Exception):
    """The end of a build whose render was cancelled. Nobody waits for it, so that no user sees it."""


def check_cancelled(cancelled: Callable[[], bool]) -> None:
    """Raise `BuildCancelledError` if `cancelled` says so."""
    if cancelled():
        raise BuildCancelledError


class OutOfMemoryError(RayBatchError, MemoryError):
    """A render that does not fit in memory, even with everything reduced."""


class BudgetError(OutOfMemoryError):
    """A budget that a setting gives, and that is less than the scene needs: so it is on every machine."""
