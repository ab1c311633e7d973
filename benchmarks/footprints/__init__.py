"""Parts of `benchmarks.footprint`: bare peers, one worker by its pipes, a process as the kernel sees it."""
