"""Pictures of a scene that is being edited: coarse at once, then finer, in a thread of their own."""
