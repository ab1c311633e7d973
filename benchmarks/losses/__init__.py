"""Parts of `benchmarks/recovery.py`: the losses, the programs that detect them, and the outcome."""
