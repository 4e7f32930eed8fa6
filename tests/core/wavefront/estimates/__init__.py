"""Tests of raybatch_addon/core/wavefront/stages."""
