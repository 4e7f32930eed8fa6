"""Tests of raybatch_addon/core/film."""
