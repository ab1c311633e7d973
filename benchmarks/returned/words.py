"""Reports events with their time. Standard library only."""

import json
import sys
import time
from typing import Any


def report(event: str, **values: Any) -> None:
    """Write a line with an event, and the machine's monotonic time in seconds."""
    sys.stdout.write(json.dumps({"event": event, "at": time.monotonic(), **values}) + "\n")
    sys.stdout.flush()
