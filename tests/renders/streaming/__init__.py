"""Whole renders by the streaming schedule."""
