"""Rays that programs and passes ask for, in whole renders."""
