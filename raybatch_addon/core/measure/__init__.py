"""The cost of a render: counters, times, memory, and the statistics made of them."""
