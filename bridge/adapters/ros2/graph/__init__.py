"""The DDS graph: participants, endpoints, and which of them Midspan made."""
