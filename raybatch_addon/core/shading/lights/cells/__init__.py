"""Cells of space in which a volume emits light, as emitters that light sampling chooses among."""
