"""Studies of images: skies that light a scene, and textures that surfaces show."""
