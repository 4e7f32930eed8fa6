"""Checkpoints: renders that are stopped or killed go on as if nothing had been, and ranges merge."""
