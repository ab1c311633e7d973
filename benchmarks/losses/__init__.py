"""Parts of `benchmarks/recovery.py`: what is broken, who notices, and what was lost."""
