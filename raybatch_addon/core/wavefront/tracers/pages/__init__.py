"""Batching beyond memory: rays wait for pages of geometry, and a policy chooses the pages brought next."""
