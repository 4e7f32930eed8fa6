"""Renders on a cluster whose workers are killed, stopped, slowed, cut off, or damage what they send."""
