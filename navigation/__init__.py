"""The hosted navigation modules, a package each; `algorithms` are pure functions on arrays."""
