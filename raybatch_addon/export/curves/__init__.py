"""Hair, curves and point clouds as the core's segments, with what their materials read of them."""
