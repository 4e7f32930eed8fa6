"""Traces of rays: files of the rays that a render asked for, made, checked, traced again, and compared with."""
