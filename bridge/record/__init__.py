"""Recording: any topics of the hub, as they come, into files."""
