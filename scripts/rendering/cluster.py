"""Where a render goes that is not rendered by this process alone."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from lib.command import UsageError
from lib.output import print_notes

from raybatch_addon.blender.cluster.command import local_workers, names_cluster
from raybatch_addon.blender.kernel_cache import kernel_cache_folder


def check_cluster(text: str) -> str:
    """`text`, if it names a cluster; raises `UsageError`."""
    if not names_cluster(text):
        raise UsageError(
            f"--cluster {text}: give a scheduler's address, as tcp://host:8786, or local:N for N workers here"
        )
    return text


@contextlib.contextmanager
def cluster_session(text: str) -> Iterator:
    """A session of the cluster that `text` names; raises `ClusterError`."""
    from raybatch_addon.core.cluster.connection import Connection
    from raybatch_addon.core.cluster.local import local_cluster
    from raybatch_addon.core.cluster.session import ClusterSession

    def report(line: str) -> None:
        print_notes([line])

    with contextlib.ExitStack() as stack:
        if count := local_workers(text):
            text = stack.enter_context(local_cluster(count, str(kernel_cache_folder())))
        connection = Connection(text, report)
        stack.callback(connection.close)
        if connection.dashboard and not count:
            report(f"the cluster's dashboard is {connection.dashboard}")
        session = ClusterSession(connection, report)
        stack.callback(session.close)
        yield session
