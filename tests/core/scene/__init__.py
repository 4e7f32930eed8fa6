"""Tests of raybatch_addon/core/scene."""
