"""How meshes of many triangles are divided into chunks of triangles that are near each other."""
