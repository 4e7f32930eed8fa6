"""Renders that show the whole frame early."""
