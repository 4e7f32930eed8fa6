"""Tests of raybatch_addon/export: Blender's scenes as the core's."""
