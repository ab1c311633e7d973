"""Messages that wait for their publisher: bounded in number and in bytes, and every dropped message is counted."""

from __future__ import annotations

from bridge.routing.backlog import Backlog, HeldMessage


class Line:
    """A backlog, and the number of messages that it dropped."""

    def __init__(self, most: int, room: int) -> None:
        self.dropped = 0
        self.backlog: Backlog[str] = Backlog(most, room, self._drop)

    def _drop(self) -> None:
        self.dropped += 1

    def pop_all(self) -> list[str]:
        return [waiting.message for waiting in self.backlog.pop_matching(lambda _: True)]


def test_the_oldest_messages_are_dropped_above_the_number_limit() -> None:
    line = Line(most=2, room=1000)
    for message in ("a", "b", "c"):
        line.backlog.add("source", message, 10)
    assert (line.dropped, line.pop_all()) == (1, ["b", "c"])


def test_the_oldest_messages_are_dropped_above_the_byte_limit_but_never_the_newest() -> None:
    line = Line(most=100, room=25)
    for message in ("a", "b", "c"):
        line.backlog.add("source", message, 10)
    assert line.dropped == 1
    line.backlog.add("source", "map", 1000)
    assert (line.dropped, line.pop_all()) == (3, ["map"])
    line.backlog.add("source", "d", 25)
    assert (line.dropped, line.pop_all()) == (3, ["d"]), "removed messages free their space"


def test_only_the_newest_messages_of_a_publisher_are_kept() -> None:
    line = Line(most=100, room=30)
    removed = [line.backlog.keep(source, message, 10, depth=2) for source, message in ("xa", "yb", "xc", "xd")]
    assert (removed, line.dropped, line.pop_all()) == ([0, 0, 0, 1], 0, ["b", "c", "d"])


def test_messages_that_are_put_back_keep_their_age() -> None:
    line = Line(most=100, room=1000)
    for source, message in ("xa", "yb", "xc"):
        line.backlog.add(source, message, 1)
    (waiting,) = line.backlog.pop_matching(lambda w: w.source == "y")
    assert (waiting.message, len(line.backlog)) == ("b", 2)
    old = HeldMessage("y", "old", 1, since=0.0)
    line.backlog.put_back(old)
    assert [w.message for w in line.backlog.pop_matching(lambda w: w.since < 1.0)] == ["old"]
    assert line.pop_all() == ["a", "c"]
