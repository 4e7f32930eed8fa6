"""Ops of textures: procedural ones, images and skies."""
