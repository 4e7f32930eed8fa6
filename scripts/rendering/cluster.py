"""Where a render goes that is not rendered by this process alone."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import TYPE_CHECKING

from lib.command import UsageError
from lib.output import print_notes

from raybatch_addon.blender.cluster.command import local_workers, names_cluster
from raybatch_addon.blender.kernel_cache import kernel_cache_folder

if TYPE_CHECKING:
    from raybatch_addon.core.cluster.session import ClusterSession
    from raybatch_addon.core.settings.settings import RenderSettings


def check_cluster(text: str) -> str:
    """`text`, if it names a cluster; raises `UsageError`."""
    if not names_cluster(text):
        raise UsageError(
            f"--cluster {text}: give a scheduler's address, as tcp://host:8786, or local:N for N workers here"
        )
    return text


def refuse_own_device(assignments: Iterable[str]) -> None:
    """Raise `UsageError` where `assignments`, as of --set, have what workers have of their own."""
    variables = {"device": "RAYBATCH_DEVICE", "thread_count": "RAYBATCH_THREADS"}
    for name in (each.partition("=")[0].strip() for each in assignments):
        if name in variables:
            raise UsageError(
                f"{name} is given, but workers of a cluster have their own: leave it out, and start workers with "
                f"{variables[name]}=VALUE (those of local:N choose by themselves)"
            )


def open_session(stack: contextlib.ExitStack, text: str, settings: RenderSettings) -> ClusterSession:
    """A session of the cluster that `text` names, for renders with `settings`, until `stack` closes. Settings that no
    cluster takes are refused first. Raises `SettingsError`, and `ClusterError`.
    """
    from raybatch_addon.core.cluster.connection import Connection
    from raybatch_addon.core.cluster.local import local_cluster
    from raybatch_addon.core.cluster.session import ClusterSession, refuse_clock

    def report(line: str) -> None:
        print_notes([line])

    refuse_clock(settings)
    if count := local_workers(text):
        report(f"starting {count} worker{'s' if count > 1 else ''}")
        text = stack.enter_context(local_cluster(count, str(kernel_cache_folder())))
    else:
        report(f"waiting for the scheduler at {text}")
    connection = Connection(text, report)
    stack.callback(connection.close)
    if connection.dashboard and not count:
        report(f"the cluster's dashboard is {connection.dashboard}")
    session = ClusterSession(connection, report)
    stack.callback(session.close)
    return session
