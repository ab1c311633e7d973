"""Parts of `benchmarks.footprint`: bare peers, one worker, and the kernel's memory and CPU figures for a process."""
