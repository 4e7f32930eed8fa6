"""The streaming schedule: one persistent kernel, whose warps choose what they do next from queues on the device."""
