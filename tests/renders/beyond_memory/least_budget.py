"""Renders with little more than one page on the device."""

from pathlib import Path

from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import schedule_scenes

ESTIMATOR = RenderSettings(sample_count=3, bounce_max=5, roulette_bounce=2)
CHECKED = dict(batching="ON", debug_checks="ON")
DISK = dict(CHECKED, geometry_store="DISK")


def render(session, name="mixed", **change):
    """The film of a scene of `schedule_scenes` with little more than one page on the device."""
    budget = schedule_scenes.least_budget(session.device.alias, name) + 500
    return session.render(
        schedule_scenes.SCENES[name](), ESTIMATOR.replace(**{**DISK, "geometry_budget": budget, **change})
    )


def the_file(pages: Path) -> Path:
    """The one file of pages in the folder `pages`."""
    (found,) = pages.iterdir()
    return found
