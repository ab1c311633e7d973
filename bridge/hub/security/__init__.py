"""Other machines: the door that they come in by, their certificates, and what they may do."""
