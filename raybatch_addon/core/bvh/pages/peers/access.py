"""Whether devices can hold pages for each other: each must read the memory of all others by itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import warp as wp

from ....device.devices import is_alike


def why_apart(devices: Sequence[wp.Device]) -> str:
    """Why `devices` cannot hold pages for each other; empty where they can."""
    if len(devices) < 2:
        return "one device renders"
    first = devices[0]
    for other in devices:
        if not is_alike(first, other):
            return f"{first.alias} and {other.alias} are of unlike models"
    for owner, reader in _pairs(devices):
        supported = wp.is_mempool_access_supported if wp.is_mempool_enabled(owner) else wp.is_peer_access_supported
        if not supported(owner, reader):
            return _refusal(owner, reader)
    return ""


def let_read(devices: Sequence[wp.Device]) -> str:
    """Let each of `devices` read the memory of all others from now on; what went wrong, or an empty text.

    Called before pages are allocated, on the thread that begins the render. Warp takes memory from the device's pool
    where there is one, whose access is a matter of its own.
    """
    for owner, reader in _pairs(devices):
        pooled = wp.is_mempool_enabled(owner)
        is_on = wp.is_mempool_access_enabled if pooled else wp.is_peer_access_enabled
        turn = wp.set_mempool_access_enabled if pooled else wp.set_peer_access_enabled
        try:
            if not is_on(owner, reader):
                turn(owner, reader, True)
        except (RuntimeError, ValueError):
            return _refusal(owner, reader)
    return ""


def _pairs(devices: Sequence[wp.Device]) -> Iterator[tuple[wp.Device, wp.Device]]:
    """An owner of memory and a reader of it: of all `devices`, each with each."""
    return ((owner, reader) for owner in devices for reader in devices if owner != reader)


def _refusal(owner: wp.Device, reader: wp.Device) -> str:
    return f"{reader.alias} cannot read the memory of {owner.alias}"
