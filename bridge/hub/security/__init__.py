"""Other machines: the external listener that they connect to, their certificates, and what they may do."""
