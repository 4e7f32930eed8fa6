"""Ops that write closures and stack them in layers."""
