"""What the benchmarks of endurance share: a daemon between programs of every side, and what its processes hold."""
