"""The programs of `benchmarks/frames_load.py`: one on each side, controlled as in `tests.peers.peer`."""
