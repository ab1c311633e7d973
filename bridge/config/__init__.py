"""Midspan's configuration: one YAML file, its model, its loader and what is generated from the model.

Workers get theirs from the daemon and need the model alone, so this imports nothing.
"""
