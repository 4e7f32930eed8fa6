"""Tests of raybatch_addon/core/bvh/build."""
