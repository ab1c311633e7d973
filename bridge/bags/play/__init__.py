"""Playing bags onto the hub, each topic as its side would publish it."""
