"""The doctor: looks for what commonly goes wrong around a bridge, and says the cure. Nothing of it needs a daemon."""
