"""Images on the device."""

import warp as wp


@wp.struct
class ImageTable:
    """All images of a scene."""

    texels: wp.array(dtype=float)
