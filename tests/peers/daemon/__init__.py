"""Real daemons, with real or fake workers."""
