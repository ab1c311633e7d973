"""How long an engine takes to check both graphs when there are many endpoints and one of them, or none, has changed.

Half of the endpoints are on the side (in memory), half on the hub (another session), each on a separate topic; one more
is added and removed on each. The `peer` column has the same check with 50 endpoints, because a check that processes
only changes costs the same with thousands.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.rows import Row, add_json_option, report
from bridge.config.sections.routing import RoutingSection
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from bridge.routing.edge import MadeBy
from bridge.routing.engine import Engine
from tests.peers.fake import FakeEdge, FakeNetwork
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

TYPE = "std_msgs/msg/String"
FEW = 50
UP_SECONDS = 120.0


class EngineUnderLoad:
    """An engine between a number of endpoints."""

    def __init__(self, hubs: HubNetwork, count: int, registry: Registry) -> None:
        self._network = FakeNetwork()
        self._hash = registry.ros2(TYPE).type_id
        self._other = Hub.open(hubs.settings("other"))
        self._hub = Hub.open(hubs.settings("midspan"))
        edge = FakeEdge(self._network, registry)
        self._engine = Engine(edge, self._hub, RoutingSection(), "midspan", print, registry)
        self._durations: list[float] = []
        self._time_checks()
        for number in range(count // 2):
            self._native(f"/side/t{number}")
            self._other.publisher(f"/hub/t{number}", TYPE, self._hash, Qos())
        self._engine.start()
        until(lambda: len(self._engine.routes()) >= 2 * (count // 2), f"{count} endpoints have routes", UP_SECONDS)

    def _native(self, topic: str) -> Callable[[], None]:
        writer = self._network.write_on(topic, TYPE, Qos(), MadeBy.NATIVE, "/node")
        return lambda: self._network.remove(writer)

    def _time_checks(self) -> None:
        loop = self._engine._loop
        check = loop._check

        def timed() -> bool:
            began = time.perf_counter()
            again = check()
            self._durations.append(time.perf_counter() - began)
            return again

        loop._check = timed

    def _settle(self) -> None:
        """Wait until no check is pending, so that the next check is caused by the next change."""
        while True:
            before = len(self._durations)
            time.sleep(0.15)
            if len(self._durations) == before:
                return

    def change(self, times: int) -> list[float]:
        """Add an endpoint on the side, replace it with one on the hub, and remove that; repeat.

        Return the duration of each check in seconds.
        """
        self._settle()
        self._durations.clear()
        for number in range(times):
            remove = self._native(f"/more/s{number}")
            self._settle()
            remove()
            publisher = self._other.publisher(f"/more/h{number}", TYPE, self._hash, Qos())
            self._settle()
            publisher.close()
            self._settle()
        return list(self._durations)

    def idle(self, times: int) -> list[float]:
        """Return the duration in seconds of each check when nothing has changed."""
        self._settle()
        self._durations.clear()
        for _ in range(times):
            self._engine.graph_changed()
            self._settle()
        return list(self._durations)

    def close(self) -> None:
        self._engine.stop()
        self._hub.close()
        self._other.close()


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--endpoints", nargs="+", type=int, default=[500, 2000], metavar="N", help="numbers of existing endpoints"
    )
    parser.add_argument("--times", type=int, default=10, metavar="N", help="rounds of changes (default %(default)s)")
    add_json_option(parser)
    args = parser.parse_args(arguments)
    registry, baseline, rows = Registry(), dict[tuple[str, str], float](), list[Row]()
    for count in (FEW, *args.endpoints):
        with HubNetwork() as hubs:
            engine = EngineUnderLoad(hubs, count, registry)
            try:
                durations = {"one changed": engine.change(args.times), "nothing changed": engine.idle(2 * args.times)}
            finally:
                engine.close()
        for change, values in durations.items():
            cuts = statistics.quantiles(values, n=100, method="inclusive")
            for figure, seconds in (("p50", cuts[49]), ("p99", cuts[98])):
                peer = baseline.setdefault((change, figure), seconds)
                rows.append(Row(f"{count} endpoints, {change}, {figure}", seconds * 1e3, peer * 1e3, "ms"))
    report(rows, args.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
