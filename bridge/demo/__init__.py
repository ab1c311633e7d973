"""The verb ``demo``: a robot sent to rooms by clients of every side, or topics of every side, bridged."""
