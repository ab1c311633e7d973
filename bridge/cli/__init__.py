"""The command ``midspan``: one package for each group of verbs."""
