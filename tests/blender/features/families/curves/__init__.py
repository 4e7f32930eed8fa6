"""Features of hair, curves and point clouds."""
