"""Renders that several devices share."""
