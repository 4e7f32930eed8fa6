"""What Blender says of a render while it goes on."""
