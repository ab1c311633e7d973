"""The programs of `benchmarks/frames_load.py`: one on each side, driven as `tests.support.peer` says."""
