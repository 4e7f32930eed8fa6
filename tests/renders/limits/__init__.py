"""Renders whose paths end by limits, or leave out light that is chosen."""
