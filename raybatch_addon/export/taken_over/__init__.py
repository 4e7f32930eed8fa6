"""Settings of Blender's own engines as ours: what corresponds to what, what differs, and how it is taken over."""
