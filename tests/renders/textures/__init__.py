"""Renders of scenes whose images do not fit into the memory of the device."""
