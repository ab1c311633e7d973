"""Programs, stand-ins and rigs that tests drive, by middleware."""
