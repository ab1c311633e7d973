"""Recording: selected topics of the hub into files."""
