"""Closures of hair: how a thin fibre scatters light, seen from any side of it."""
