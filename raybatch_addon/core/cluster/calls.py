"""How work is asked for: by name, of whatever the library is called where the worker is. Sent as it stands here."""


def call(name, *arguments):
    """What the function `name` of `work` returns there, or for an error that is RayBatch's own its `error`, the name of
    its kind, and its `text`: its class may be unknown to who asked. Raises `OSError` where the machine is at fault.
    """
    import importlib

    for library in ("raybatch", "raybatch_addon.core"):
        try:
            work = importlib.import_module(f"{library}.cluster.work")
        except ModuleNotFoundError as error:
            if not f"{library}.cluster.work".startswith(str(error.name)):
                raise
            continue
        errors = importlib.import_module(f"{library}.errors")
        try:
            return getattr(work, name)(*arguments)
        except errors.RayBatchError as error:
            text = " ".join(str(error).split())
            machines = isinstance(error, (errors.DeviceError, errors.OutOfMemoryError))
            if machines and not isinstance(error, errors.BudgetError):
                raise OSError(text) from None
            return {"error": type(error).__name__, "text": text}
    raise ModuleNotFoundError(
        "RayBatch is not installed on this worker; install its wheel: "
        'pip install "$(echo dist/raybatch-*.whl)[cluster]"'
    )


def keep_copies(dask_scheduler=None):
    """Have the scheduler leave alone what several workers hold: a film of which it dropped the second copy, as it does
    with what nobody waits for, would be lost with its worker.
    """
    manager = dask_scheduler.extensions.get("amm")
    for policy in [*getattr(manager, "policies", ())]:
        if type(policy).__name__ == "ReduceReplicas":
            manager.policies.discard(policy)


def has_dashboard(dask_scheduler=None):
    """Whether the scheduler shows pages: it has none without Bokeh, or where it was started so, but an address."""
    return bool(getattr(dask_scheduler.http_application, "applications", ()))


def failed_on(key, dask_scheduler=None):
    """The hosts on which the task `key`, or the one that it failed by, raised its error."""
    from distributed.comm import get_address_host

    task = dask_scheduler.tasks.get(key)
    task = task and (task.exception_blame or task)
    return sorted({get_address_host(address) for address in (task.erred_on or () if task else ())})


async def drop(address, dask_scheduler=None):
    """Have the scheduler go on without the worker at `address`."""
    await dask_scheduler.remove_worker(address=address, stimulus_id="raybatch-silent", close=False)
