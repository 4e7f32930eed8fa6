"""The Rendered mode of the 3D view: what Blender's callbacks do, and how the picture gets on the screen."""
