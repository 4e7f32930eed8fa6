"""The tracers that benchmark.py traversal compares, peers such as Embree among them."""
