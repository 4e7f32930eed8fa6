"""Adaptive sampling: which pixels go on, decided between rounds by the noise that two halves of the samples show."""
