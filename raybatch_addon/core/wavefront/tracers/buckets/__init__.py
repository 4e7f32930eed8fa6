"""Batching in memory: rays wait in queues at treelets, and a policy chooses the queue served next."""
