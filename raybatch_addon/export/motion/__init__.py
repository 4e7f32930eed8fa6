"""Motion blur: the frame stepped through the time of its shutter, and what moves meanwhile."""
