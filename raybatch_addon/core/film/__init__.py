"""The film: exact sums of samples, their passes, and merging."""

from ..device import declared  # noqa: F401 - before anything is declared: declarations wait
from .channels import ChannelLayout, layout_of
from .film import Film
from .layout import FIRST_SAMPLE_PASSES, PASSES

__all__ = ["FIRST_SAMPLE_PASSES", "PASSES", "ChannelLayout", "Film", "layout_of"]
