"""How far a tile has come, and how many rays were traced."""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from ..film.tile import FinishedTile
from ..native.structs import copied_by_host
from .scheduler import Rectangle


@dataclass
class TileState:
    """How far a tile has come, or one half of its samples; with it a stopped tile goes on later."""

    tile: Rectangle
    items_begun: int = 0  # paths generated so far in this round, in the sample order
    drained: bool = True  # all of them are in the film
    half: int = 0  # which of the film's halves; 0 where there is one film
    held: FinishedTile | None = None  # what it has so far, on the device, while the render goes on
    active: wp.array | None = None  # pixels that get samples, int32, as `active_number` takes them; None: all

    @property
    def place(self) -> str | None:
        """The device that has its sums; None where there are none yet."""
        return None if self.held is None else self.held.film.window.device.alias

    def move_to(self, device: wp.Device) -> None:
        """Go on with it there."""
        if self.held is not None:
            self.held = self.held.on(device)
        if self.active is not None and self.active.device != device:
            self.active = copied_by_host(self.active, device)

    @property
    def pixel_count(self) -> int:
        """Pixels that get samples in this round."""
        return self.tile.pixel_count if self.active is None else self.active.size


@dataclass
class RayTotals:
    """Rays traced so far."""

    camera: int = 0
    bounced: int = 0  # scattered, or gone on behind a transparent surface
    shadow: int = 0

    @property
    def total(self) -> int:
        """Rays of all kinds."""
        return self.camera + self.bounced + self.shadow
