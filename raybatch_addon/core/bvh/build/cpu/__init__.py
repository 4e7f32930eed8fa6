"""Binary trees by the surface area heuristic, with spatial splits, on the CPU."""
