"""Views through cameras: stereoscopy, and what moves while a shutter is open."""
