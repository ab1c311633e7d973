"""Midspan's configuration: one YAML file, its model, its loader and what is generated from the model.

Workers receive their configuration from the daemon and need only the model, so this package imports nothing.
"""
