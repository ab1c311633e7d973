"""BaseControl: drives a mobile base as its inputs command, within its limits, and tells where it has come to."""
