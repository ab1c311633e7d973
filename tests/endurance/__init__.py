"""What lasts: endpoints that come and go, and subscribers that are slow. Longer by hand: benchmarks/."""
