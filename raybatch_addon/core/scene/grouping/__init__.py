"""Which baked instances share a tree, and how that goes on from frame to frame where some come and others go."""
