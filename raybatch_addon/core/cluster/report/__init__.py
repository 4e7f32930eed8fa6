"""What a report says of a render on a cluster."""
