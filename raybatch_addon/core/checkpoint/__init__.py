"""Checkpoints: films in files, from which stopped and killed renders go on, and which merge."""

INTERVAL_DEFAULT = 60.0  # from one checkpoint to the next [s]
