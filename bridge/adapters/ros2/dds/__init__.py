"""The two DDS implementations that the worker's own participant can run on."""
