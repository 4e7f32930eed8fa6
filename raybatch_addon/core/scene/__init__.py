"""A scene before it reaches a device: its description, what it needs, its checks and its file."""
