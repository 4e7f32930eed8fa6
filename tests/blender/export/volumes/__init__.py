"""Tests of the export of volumes."""
