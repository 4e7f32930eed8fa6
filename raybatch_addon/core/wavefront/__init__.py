"""The wavefront: rays and paths in arrays, and the loop of stages that moves them."""
