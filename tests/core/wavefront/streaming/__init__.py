"""The queues of the streaming schedule."""
