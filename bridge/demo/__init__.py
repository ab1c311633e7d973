"""The demo: real programs of every side, the daemon between them, and checks of what crossed."""
