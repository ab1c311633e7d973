"""Which ROS 2 origins on the hub count as being on this worker's own DDS network."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.adapters.ros2.graph import origins as module
from bridge.adapters.ros2.graph.origins import Origins, new_prefix, participant_number, stored_prefixes
from bridge.concurrency import DelayedCalls
from tests.support.wait import until

HOST = b"\x01\x0f\x00\x00"


class Case:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.seen: set[bytes] = set()
        self.settled = threading.Event()
        self.later = DelayedCalls("test-origins")

    def start(self, own: bytes) -> Origins:
        return Origins(own, self.folder, lambda: frozenset(self.seen), self.settled.set, self.later)


@pytest.fixture
def case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Case]:
    monkeypatch.setattr(module, "DISCOVERY_SECONDS", 0.05)
    case = Case(tmp_path)
    yield case
    case.later.close()


def test_own_and_seen_participants_count_as_own(case: Case) -> None:
    current, seen = new_prefix(HOST), new_prefix(HOST)
    case.seen.add(seen)
    origins = case.start(current)
    assert origins.is_own(current.hex())
    assert origins.is_own(seen.hex())
    assert not origins.is_own("not hex")


def test_an_undiscovered_participant_counts_as_own_for_a_while(case: Case) -> None:
    origins, other = case.start(new_prefix(HOST)), new_prefix(HOST)
    assert origins.is_own(other.hex())
    until(case.settled.is_set, "the time is over")
    until(lambda: not origins.is_own(other.hex()), "the origin is foreign")


def test_dead_predecessors_are_own(case: Case) -> None:
    dead, current = new_prefix(HOST), new_prefix(HOST)
    case.start(dead)
    origins = case.start(current)
    case.settled.wait(0.1)
    assert origins.is_own(dead.hex())


def test_a_corrupt_or_long_file_is_tolerated(case: Case) -> None:
    old = [new_prefix(HOST).hex() for _ in range(100)]
    (case.folder / "prefixes").write_text("\n".join(["junk", *old]))
    case.start(new_prefix(HOST))
    kept = (case.folder / "prefixes").read_text().split()
    assert len(kept) == 64
    assert kept[-2] == old[-1]


def test_a_successor_gets_another_number_and_other_ports(case: Case) -> None:
    past: list[bytes] = []
    for _ in range(12):
        past.append(new_prefix(HOST, past))
        case.start(past[-1])
    assert stored_prefixes(case.folder) == past
    numbers = [participant_number(prefix) for prefix in past]
    assert all(number not in numbers[max(0, i - 8) : i] for i, number in enumerate(numbers))
    assert all(number >= 32 for number in numbers), "above the numbers of other participants, which count from 0"


def test_ports_of_every_number_exist_in_the_highest_domain() -> None:
    numbers = {participant_number(HOST + bytes((first, 0, 0, 0)) + b"MSPN") for first in range(256)}
    assert 7400 + 250 * 232 + 11 + 2 * max(numbers) < 65536  # DDSI-RTPS 2.5, 9.6.2.3


def test_invalid_stored_prefixes_are_ignored(case: Case) -> None:
    (case.folder / "prefixes").write_text(f"no hex\nabcd\n{new_prefix(HOST).hex()}\n")
    assert len(stored_prefixes(case.folder)) == 1
