"""Parts of `benchmarks.footprint`: bare peers, a single worker, and the kernel's figures of a process."""
