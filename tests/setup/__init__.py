"""The set-up: what `make` installs, and that it does so only when needed."""
