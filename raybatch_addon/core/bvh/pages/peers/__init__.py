"""Pages in the memory of the devices that share a render: each holds a part of them once, for all."""
