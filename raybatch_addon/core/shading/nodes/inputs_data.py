"""What input ops read of the scene beside its triangles."""

import warp as wp


@wp.struct
class InputData:
    """Arrays that no program of the scene reads have no entries."""

    uvs: wp.array(dtype=wp.vec2)  # of triangle corners, [3 * triangle_count]
