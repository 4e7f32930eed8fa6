"""Tests of what others measure with: studies of their own, traces of rays, the notebook."""
