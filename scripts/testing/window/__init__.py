"""Scripts that run inside a Blender with a window, and try the viewport there as a person does."""
