"""The arguments that a stage is launched with."""

from __future__ import annotations

from enum import IntEnum

import warp as wp


class ShadingStage(IntEnum):
    """A stage that shades, as `TileWork.stage` has it."""

    SURFACE = 0
    BACKGROUND = 1
    LIGHT_HITS = 2
    CONNECT = 3
    CONNECT_TRANSPARENT = 4
    AIM = 5
    # before all others: a path's program, or a pass, asks for rays
    REQUEST = 9
    OCCLUSION = 10


class VolumeStage(IntEnum):
    """A stage of volumes that runs their programs, as `TileWork.stage` has it."""

    SCATTER = 6
    TRANSMIT = 7
    BOUND = 8


@wp.struct
class TileWork:
    """The paths of a tile, numbered: item -> (pixel, sample). A path keeps its number alone."""

    x: int  # of the tile's bottom left in the frame [pixels]
    y: int
    width: int
    height: int
    frame_width: int
    sample_first: wp.int64
    sample_count: wp.int64
    pixel_first: int  # 1: all samples of a pixel come one after another; 0: all pixels for each sample
    item_base: wp.int64  # the item that paths have as number 0
    item_first: wp.int64  # next item that was not begun
    item_count: int  # how many to begin
    filter_table: wp.array(dtype=float)
    stage: int  # `ShadingStage` or `VolumeStage`: what a kernel of all stages is launched for
