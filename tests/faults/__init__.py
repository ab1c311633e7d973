"""What is lost, and how it comes back."""
