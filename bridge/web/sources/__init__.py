"""What both the feeds and the verbs of the console use; these packages do not import each other."""
