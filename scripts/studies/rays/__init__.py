"""Rays that several studies trace."""
