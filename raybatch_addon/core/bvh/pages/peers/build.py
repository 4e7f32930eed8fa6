"""Scenes whose pages lie in the memory of all devices that render."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from ....scene.flatten import FlatGeometry
from ...node import Layout
from ..budget import expected_bytes
from ..build import build_paged_scene
from ..divide.primitives import Primitives
from ..paged_scene import PagedScene
from .share import ShareTooLargeError, ways_to_hold
from .shared import PeerPages


def build_with_peers(
    peers: PeerPages,
    flat: FlatGeometry,
    visibility: np.ndarray,
    layout: Layout,
    device: wp.Device,
    *,
    budget: int,
    encoded: bool,
    cancelled: Callable[[], bool],
    **more: Any,
) -> PagedScene:
    """As `build_paged_scene` with the store PEERS, of which `peers` says what `device` is; all of its devices have the
    same `budget`. The first that comes builds the pages.

    `encoded`: triangles are packed where the shares are short. `more`: as for `build_paged_scene`.
    """
    primitives = Primitives.of(flat)
    plain, packed = (expected_bytes(primitives, flat.curves, layout, encoded) for encoded in (False, True))
    ways = ways_to_hold(budget, len(peers.devices), plain, packed if encoded else None)
    for way in ways[:-1]:
        try:
            return _built(way, peers, flat, visibility, layout, device, budget=budget, cancelled=cancelled, **more)
        except ShareTooLargeError:
            pass
    made = _built(ways[-1], peers, flat, visibility, layout, device, budget=budget, cancelled=cancelled, **more)
    made.statistics["store_warning"] = (
        f"geometry_store is HOST, not PEERS: a geometry budget of {budget:,} bytes leaves no room for pages of others"
    )
    return made


def _built(way: Any, peers: PeerPages, *given: Any, **more: Any) -> PagedScene:
    return build_paged_scene(*given, store="PEERS", encoded=way.encoded, peers=replace(peers, way=way), **more)
