"""What pages of the console may ask for."""
