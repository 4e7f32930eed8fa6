"""The stages of the loop: each file has one kernel, or a few."""
