"""Files that people made, rendered by Cycles and by RayBatch and held against each other."""
