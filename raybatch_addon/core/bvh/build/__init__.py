"""Building trees: binary ones first, collapsed to wide nodes, and refitted from frame to frame."""
