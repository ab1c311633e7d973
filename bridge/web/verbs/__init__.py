"""The console's verbs: commands and queries of pages."""
