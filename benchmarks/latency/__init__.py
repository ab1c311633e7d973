"""Parts of the latency benchmark: cases, the programs at both ends, the network between them, the figures."""
