"""Counts of volumes: where light in them was estimated by less than there is, with words where that matters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

# Sums of shares on the device are in units of 1 over this
SHARE_UNITS = 1 << 20
# Shares from which on a picture may show it: of the density that rays met, and of rays or paths
_DENSITY_MATTERS, _RAYS_MATTER = 0.01, 0.001


@dataclass(frozen=True)
class VolumeCounts:
    """Counts of all workers, in the order of the columns of `VolumeData.counts`."""

    collisions: int  # points where flights through volumes whose density varies ended, null collisions too
    exceeded: int  # those of them where the extinction was above the bound that it has there
    density: int  # sum of the extinction over the bound at collisions, 1 at most each [1 / SHARE_UNITS]
    density_lost: int  # sum of what there was above 1 [1 / SHARE_UNITS]
    shadow_rays: int  # pieces of shadow rays, and of other ways to lights, through volumes whose density varies
    shadow_rays_cut: int  # those of them that ended before their end, after as many flights as they may have
    paths_cut: int  # paths that ended because their way had as many pieces as it may have

    @property
    def missing(self) -> float:
        """Share of the density that rays met that is not in the picture, as bounds are too low: 0 to 1."""
        whole = self.density + self.density_lost
        return self.density_lost / whole if whole else 0.0

    def report(self) -> dict[str, Any]:
        """For the statistics (see docs/statistics.md)."""
        return {
            "collisions": self.collisions,
            "exceeded": self.exceeded,
            "density_missing": round(self.missing, 6),
            "shadow_rays": self.shadow_rays,
            "shadow_rays_cut": self.shadow_rays_cut,
            "paths_cut": self.paths_cut,
        }

    def warnings(self, path_count: int) -> list[str]:
        """What of it a picture may show; `path_count`: of the render."""
        found = []
        if self.missing >= _DENSITY_MATTERS:
            found.append(
                f"volumes: {100 * self.missing:.2g} % of the density that rays met is missing in the picture: at "
                f"{self.exceeded:,} of {self.collisions:,} points it was above the bound that was found there, and "
                "counted as that; details that are small beside their object are found better in an object of their own"
            )
        if self.shadow_rays_cut > _RAYS_MATTER * self.shadow_rays:
            found.append(
                f"volumes: {self.shadow_rays_cut:,} of {self.shadow_rays:,} shadow rays ended before they were through "
                "a volume, which is taken to be empty from there on: it is very dense in places"
            )
        if self.paths_cut > _RAYS_MATTER * path_count:
            found.append(
                f"volumes: {self.paths_cut:,} of {path_count:,} paths ended on their way through a volume after as "
                "many steps as there may be, so that light is missing: it is very dense in places"
            )
        return found
