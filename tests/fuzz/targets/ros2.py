"""ROS 2: the state folder's GUID prefixes, and network identities from the hub."""

from __future__ import annotations

from tests.fuzz.target import Subject, Target, scratch, texts


def _prefixes() -> Subject:
    """The file with past participants in the state folder."""
    from bridge.adapters.ros2.graph.origins import remember

    file = scratch() / "prefixes"
    own_prefix = bytes(range(12))

    def parse(data: bytes) -> None:
        file.write_bytes(data)
        past = remember(own_prefix, file)
        assert own_prefix in past
        assert len(past) <= 64
        assert len(file.read_bytes()) < 64 * 8192 + 100

    seeds = [b"".join(bytes([n] * 12).hex().encode() + b"\n" for n in range(20)), b""]
    return Subject(parse, seeds, (), texts("\n", "zz", "0102", " ", "\x00", "\x85"))


def _network() -> Subject:
    """A network identity in another session's origin."""
    from bridge.adapters.ros2.graph.origins import Origins, is_marked
    from bridge.concurrency import DelayedCalls

    folder = scratch()
    own_prefix = bytes(range(12))
    origins = Origins(own_prefix, folder, frozenset, lambda: None, DelayedCalls("fuzz-origins"))
    # entries expire at once, without a timer for each
    origins._first_seen = _Seen()

    def parse(data: bytes) -> None:
        network = data.decode(errors="replace")
        mine = origins.is_own(network)
        assert not mine or bytes.fromhex(network) == own_prefix
        is_marked(data)

    seeds = [own_prefix.hex().encode(), bytes(12).hex().encode(), b"run-id-of-ros1"]
    return Subject(parse, seeds, (), texts("00", " ", "\t", "g"), 200)


class _Seen(dict[bytes, float]):
    """First-seen times, in which each prefix was first seen long ago."""

    def get(self, _prefix: bytes, _default: object = None) -> float:  # type: ignore[override]
        return 0.0


TARGETS = (
    Target("ros2_prefixes", 5_000, _prefixes),
    Target("ros2_network", 20_000, _network),
)
