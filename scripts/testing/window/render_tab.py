"""The Render tab of the Properties editor for `walk.py`: its panels are opened by clicks, and shown alone or all."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import hands
from pictures import Box, Pictures, box_of

# From the top of the tab at scale 1 [pixels]
_ENGINE, _PANEL_TOP, _HEADER = 54, 74, 89
_CLOSED_MOST = 40  # the height of a closed panel at most
_KEY = 0.3  # until Blender has read it [s]
_SETTLED = 0.8  # until a panel has opened and is drawn [s]


class RenderTab:
    """The panels of the Render tab. Steps that wait are generators of the seconds to wait."""

    def __init__(self, pictures: Pictures) -> None:
        self._pictures = pictures
        self._alone = ""  # the only panel that is shown; empty: all
        self._polls = {
            panel: panel.poll
            for panel in bpy.types.Panel.__subclasses__()
            if getattr(panel, "bl_space_type", "") == "PROPERTIES"
            and getattr(panel, "bl_context", "") == "render"
            and panel.__name__ != "RENDER_PT_context"
            and hasattr(panel, "poll")
        }
        for panel, poll in self._polls.items():
            panel.poll = classmethod(self._poll_of(poll))

    def _poll_of(self, poll):
        def shown(panel, context):
            return self._alone in ("", panel.__name__, getattr(panel, "bl_parent_id", "")) and poll(context)

        return shown

    @property
    def area(self) -> bpy.types.Area:
        """The Properties editor."""
        areas = bpy.context.window_manager.windows[0].screen.areas
        return max((each for each in areas if each.type == "PROPERTIES"), key=lambda each: each.height)

    @property
    def region(self) -> bpy.types.Region:
        """Its part with the panels."""
        return next(each for each in self.area.regions if each.type == "WINDOW")

    def turn_to(self, tab: str = "RENDER") -> None:
        """Show a tab."""
        self.area.spaces.active.context = tab
        self.area.tag_redraw()

    def click_engine(self) -> None:
        """Click on the list of render engines."""
        hands.click(self.region.x + 0.75 * self.region.width, self._top(_ENGINE))

    def open_alone(self, panel: str) -> Iterator[float]:
        """Open a panel with all that is in it, and close all others, as Ctrl and clicks on headers do."""
        yield from self._show(panel)
        if self._height() > _CLOSED_MOST:
            yield from self._click_header()
        yield from self._click_header("ctrl")
        height = self._height()
        if any(getattr(each, "bl_parent_id", "") == panel for each in self._polls):
            yield from self._click_header("ctrl")  # opens the panels in it, or closes them
            if self._height() < height:
                yield from self._click_header("ctrl")
        hands.place(*self._beside)
        yield from self._show("")

    def scroll_to_end(self) -> Iterator[float]:
        """Scroll down as far as it goes."""
        hands.scroll(self.region.x + 0.5 * self.region.width, self.region.y + 0.5 * self.region.height, 30)
        yield _SETTLED

    def take_panel(self, name: str, panel: str) -> Iterator[float]:
        """A picture of one panel, opened."""
        yield from self.open_alone(panel)
        yield from self._show(panel)
        box = box_of(self.region)
        box = Box(box.x0, box.y0, box.x1, round(self._top(_PANEL_TOP)))
        self._pictures.take(name, box, ends_with=self.region)
        yield from self._show("")

    def take_tab(self, name: str, panel: str) -> Iterator[float]:
        """A picture of the whole editor with nothing but one panel in it."""
        yield from self._show(panel)
        self._pictures.take(name, box_of(self.area), ends_with=self.region)
        yield from self._show("")

    def _show(self, panel: str) -> Iterator[float]:
        self._alone = panel
        self.area.tag_redraw()
        yield _SETTLED

    @property
    def _beside(self) -> tuple[float, float]:
        """A place where the mouse points at nothing: beside the editor, over the middle of its left neighbour."""
        area = self.area
        return area.x / 2, area.y + area.height / 2

    def _top(self, down: float) -> float:
        return self.region.y + self.region.height - down * bpy.context.preferences.system.ui_scale

    def _click_header(self, key: str = "") -> Iterator[float]:
        """Click on the header of the panel that is shown alone, while `key` is held."""
        if key:
            hands.hold(key)
            yield _KEY
        hands.click(self.region.x + 0.55 * self.region.width, self._top(_HEADER))
        yield _KEY
        if key:
            hands.release(key)
        yield _SETTLED

    def _height(self) -> float:
        """Of the panel that is shown alone."""
        return self._top(_PANEL_TOP) - self._pictures.lowest(self.region)
