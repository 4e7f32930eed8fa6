"""A scene on its device, and what is kept of it for the next render."""
