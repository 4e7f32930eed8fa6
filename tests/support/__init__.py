"""Scenes, devices and commands that tests share."""
