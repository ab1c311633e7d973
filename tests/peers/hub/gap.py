"""Measures gaps in the traffic between two sessions of a hub that are connected only through its router.

Usage: gap.py ENDPOINT

For each line on standard input, it prints the longest time in seconds between two received messages since the previous
line, including the time since the last message.
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

    def on_message(self, _sample: object = None) -> None:
        with self._lock:
            now = time.monotonic()
            self._worst = max(self._worst, now - self._last)
            self._last = now

    def reset(self) -> float:
        with self._lock:
            worst = max(self._worst, time.monotonic() - self._last)
            self._worst = 0.0
            return worst


def main() -> None:
    sender, receiver = session(sys.argv[1]), session(sys.argv[1])
    gap = Gap()
    subscriber = receiver.declare_subscriber(KEY, gap.on_message)
    publisher = sender.declare_publisher(KEY)
    ended = threading.Event()

    def drum() -> None:
        while not ended.wait(PERIOD):
            publisher.put(b"")

    threading.Thread(target=drum, daemon=True).start()
    for _line in sys.stdin:
        print(gap.reset(), flush=True)
    ended.set()
    subscriber.undeclare()
    sender.close()
    receiver.close()


main()
