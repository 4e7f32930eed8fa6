"""The environment that everything here runs in, made by `make environment`."""
