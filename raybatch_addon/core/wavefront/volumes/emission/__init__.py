"""Light that volumes emit: its points are aimed at, as those of lamps are, and rays that meet it count beside that."""
