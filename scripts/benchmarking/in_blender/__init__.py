"""What is measured through Blender alone, by the add-on's own way: animations, and previews."""
