"""Renders shared by many processes and machines: ranges of samples as tasks of a Dask cluster."""
