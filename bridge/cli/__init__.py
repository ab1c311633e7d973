"""The program ``midspan``: one package for each group of commands."""
