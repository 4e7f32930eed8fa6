"""Tests of raybatch_addon/core/shading/hair."""
