"""Features of nodes that compute: values, mixing, and pictures made of them."""
