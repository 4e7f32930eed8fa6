"""Entries of the menus of presets: Blender runs the file that is chosen, and what it sets is in `core/settings`."""
