"""The set-up and the distributions: what `make` installs and builds, and that it does this only when needed."""
