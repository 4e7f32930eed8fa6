"""Error against time: how errors are computed, kept, fitted and read from two halves of a render."""
