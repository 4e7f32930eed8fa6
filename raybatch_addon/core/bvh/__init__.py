"""Trees over triangles and instances: their layouts, how they are built, cut, stored and traversed."""
