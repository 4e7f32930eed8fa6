"""Whole renders compared with others of the same scene: another budget, fewer devices."""
