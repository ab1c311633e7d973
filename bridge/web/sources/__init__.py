"""Modules that both the feeds and the verbs of the console use, because these packages do not import each other."""
