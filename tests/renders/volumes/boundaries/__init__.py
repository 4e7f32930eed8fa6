"""Tests of the faces of volumes: which rays pass at once, and which lie on surfaces."""
