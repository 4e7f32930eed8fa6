"""The film: exact sums of samples, their passes, and merging."""

from .film import Film
from .layout import FIRST_SAMPLE_PASSES, PASSES, ChannelLayout, layout_of

__all__ = ["FIRST_SAMPLE_PASSES", "PASSES", "ChannelLayout", "Film", "layout_of"]
