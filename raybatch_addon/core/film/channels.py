"""Where the summed passes of a film lie among the channels of a pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..scene.passes import channels_of, summed_passes


@dataclass(frozen=True)
class ChannelLayout:
    """Where the summed passes lie among the channels of a pixel's sums."""

    transparent: bool  # alpha is summed too; otherwise it is 1
    normal: bool
    others: tuple[str, ...] = ()  # `summed_passes`

    @property
    def others_first(self) -> int:
        """The first channel of `others`."""
        return 3 + self.transparent + 3 * self.normal

    @property
    def others_count(self) -> int:
        """Channels of `others`."""
        return sum(channels_of(name) for name in self.others)

    @property
    def count(self) -> int:
        """Channels of a pixel."""
        return self.others_first + self.others_count

    @property
    def kind(self) -> ChannelLayout:
        """What kernels are specialised on: the same for all layouts that have `others`, whose number kernels read."""
        return replace(self, others=self.others and ("Mist",))

    def span(self, name: str) -> slice:
        """Channels of the pass `name`; raises `ValueError` for a pass that is not summed."""
        color = 3 + self.transparent
        if name == "Combined":
            return slice(0, color)
        if name == "Normal" and self.normal:
            return slice(color, color + 3)
        if name in self.others:
            first = self.others_first + sum(channels_of(each) for each in self.others[: self.others.index(name)])
            return slice(first, first + channels_of(name))
        raise ValueError(f"the pass {name!r} has no channels among the sums of a film: give it some in `ChannelLayout`")


def layout_of(passes: tuple[str, ...], transparent: bool) -> ChannelLayout:
    """The layout for these passes."""
    return ChannelLayout(transparent, "Normal" in passes, summed_passes(passes))
