"""What pages of the console watch, each thing a feed."""
