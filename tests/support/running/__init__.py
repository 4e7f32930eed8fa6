"""How a run of the tests goes: its order, kernels for all processes, and what it took."""
