"""Programs of each middleware that serve and call services and actions, for `benchmarks/calls.py`."""
