"""A scene that is being edited, as a viewport shows it: what an edit changed is read, and nothing else."""
