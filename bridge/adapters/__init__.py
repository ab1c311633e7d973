"""The edges: one package per side; nothing outside a side's package touches its middleware."""
