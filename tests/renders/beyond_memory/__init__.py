"""Renders of scenes whose trees do not fit into the memory of the device."""
