"""The console's and the Foxglove app's clients, and servers for them."""
