"""Pure functions on arrays: no input, no output, nothing of a module's."""
