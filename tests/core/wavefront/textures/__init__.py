"""Tests of raybatch_addon/core/wavefront/textures."""
