"""Two participants of a hub that reach each other through its router alone: how long do they not hear each other?

Usage: zenoh_gap.py ENDPOINT

Each line on the standard input is answered by a line: the longest time in seconds between two messages that one of the
two heard from the other since the line before, the time since the last one included.
"""

import sys
import threading
import time

import zenoh

KEY = "0/midspan_gap"
PERIOD = 0.02


def session(endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("scouting", '{"delay": 0, "multicast": {"enabled": false}}')
    return zenoh.open(config)


class Gap:
    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last = time.monotonic()
        self._worst = 0.0

    def heard(self, _sample: object = None) -> None:
        with self._lock:
            now = time.monotonic()
            self._worst = max(self._worst, now - self._last)
            self._last = now

    def taken(self) -> float:
        with self._lock:
            worst = max(self._worst, time.monotonic() - self._last)
            self._worst = 0.0
            return worst


def main() -> None:
    one, other = session(sys.argv[1]), session(sys.argv[1])
    gap = Gap()
    subscriber = other.declare_subscriber(KEY, gap.heard)
    publisher = one.declare_publisher(KEY)
    ended = threading.Event()

    def drum() -> None:
        while not ended.wait(PERIOD):
            publisher.put(b"")

    threading.Thread(target=drum, daemon=True).start()
    for _line in sys.stdin:
        print(gap.taken(), flush=True)
    ended.set()
    subscriber.undeclare()
    one.close()
    other.close()


main()
