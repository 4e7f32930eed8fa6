"""Scenes whose surfaces show images."""
