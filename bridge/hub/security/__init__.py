"""Access of other machines: the external listener, certificates, and access rules."""
