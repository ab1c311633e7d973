"""Which requests a worker's successor knows of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bridge.adapters.ros2 import service_unanswered
from bridge.adapters.ros2.service_rcl import RequestId
from bridge.adapters.ros2.service_unanswered import Unanswered

RESULT = "/go/_action/get_result"
GOAL = b"\x00\x01\x00\x00" + bytes(range(16))


Worker = Callable[[], Unanswered]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "state" / "unanswered"


@pytest.fixture
def worker(file: Path) -> Iterator[Worker]:
    """Starts the next worker, on the file that the one before it left as it was."""
    started: list[Unanswered] = []

    def start() -> Unanswered:
        started.append(Unanswered(file))
        return started[-1]

    yield start
    for unanswered in started:
        unanswered.close()


def request(number: int, client: int = 1) -> RequestId:
    return RequestId(bytes([client]) * 16, number)


def test_what_was_not_answered_is_left_to_the_next_and_given_once(worker: Worker) -> None:
    first = worker()
    for number in (1, 2, 3):
        first.asked(RESULT, request(number), GOAL)
    first.asked("/other/_action/get_result", request(1, 2), GOAL)
    first.answered(request(2))
    second = worker()
    assert second.left(RESULT) == [(request(1), GOAL), (request(3), GOAL)]
    assert second.left(RESULT) == []
    second.answered(request(1))
    third = worker()
    assert [r.number for r, _ in third.left(RESULT)] == [3]
    assert len(third.left("/other/_action/get_result")) == 1


def test_goals_cancels_and_calls_are_never_repeated(worker: Worker) -> None:
    first = worker()
    for name in ("/go/_action/send_goal", "/go/_action/cancel_goal", "/lamp"):
        first.asked(name, request(1), GOAL)
        assert worker().left(name) == []


def test_the_file_is_bounded(worker: Worker, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service_unanswered, "_MOST", 5)
    monkeypatch.setattr(service_unanswered, "_SPARE_LINES", 20)
    first = worker()
    for number in range(1000):
        first.asked(RESULT, request(number), GOAL)
        if number >= 3:
            first.answered(request(number))
    assert len(file.read_text().splitlines()) < 30
    first.asked(RESULT, request(0, 9), bytes(1000))
    for number in range(10):
        first.asked(RESULT, request(number, 2), GOAL)
    assert [r.number for r, _ in worker().left(RESULT)] == [0, 1, 2, 0, 1]


def test_a_broken_file_costs_its_broken_lines(worker: Worker, file: Path) -> None:
    first = worker()
    first.asked(RESULT, request(1), GOAL)
    with file.open("ab") as written:
        written.write(b"\xff\n+ zz 1 00 /x/_action/get_result\n+ 00 1 00 /go/_action/get_result\n- 0\n+ " + b"01" * 16)
    assert worker().left(RESULT) == [(request(1), GOAL)]


def test_a_folder_that_cannot_be_written_stops_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("")
    unanswered = Unanswered(tmp_path / "file" / "unanswered")
    unanswered.asked(RESULT, request(1), GOAL)
    unanswered.answered(request(1))
    assert "cannot write" in caplog.text
