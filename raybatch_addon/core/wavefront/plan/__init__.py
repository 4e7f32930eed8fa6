"""The plan of a render: whether it batches, how its kernels are launched, and why."""
