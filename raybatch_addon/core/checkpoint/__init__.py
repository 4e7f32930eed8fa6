"""Checkpoints: films in files, from which stopped and killed renders go on, and which merge."""
