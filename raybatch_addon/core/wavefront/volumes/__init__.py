"""Volumes in the loop: which of them a path is in, where in them it scatters, and what shadow rays lose there."""
