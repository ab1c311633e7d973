"""The command ``demo``: clients of every side send a robot to rooms, or topics of every side are bridged."""
