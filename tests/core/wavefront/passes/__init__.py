"""Tests of raybatch_addon/core/wavefront/passes."""
