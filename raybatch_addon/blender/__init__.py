"""A render as Blender sees it: frames, results, reports, and the sessions that outlive engine objects."""
