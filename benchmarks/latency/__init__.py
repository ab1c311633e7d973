"""Parts of the latency benchmarks: cases, the programs at both ends, the network between them, and the figures."""
