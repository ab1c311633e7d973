"""The programs of `benchmarks/returned_planner.py`."""
