"""Endurance: endpoints that are created and closed, and slow subscribers. Longer runs by hand: benchmarks/."""
