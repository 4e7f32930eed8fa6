"""What a render cost: counters, times, memory, and the statistics made of them."""
