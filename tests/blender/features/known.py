"""Quick features that are known to be out of bounds, with their figures: expected to fail, and told when they no longer do."""

KNOWN: dict[str, str] = {}
