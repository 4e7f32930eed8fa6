"""Pages made on the device that traces: from the triangles of a chunk to the bytes of a page."""
