"""The YARP programs of tests: latched messages."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.peers.yarp.programs import Definitions, Names, YarpProgram
from yarp_compat.ports.connections import ConnectionEvent

STRING = "std_msgs/String"


@pytest.fixture
def names() -> Iterator[Names]:
    names = Names()
    yield names
    names.stop()


def test_a_latched_message_is_written_once_on_a_connection_that_is_coming_up(
    names: Names, monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[tuple[YarpProgram, int, ConnectionEvent]] = []
    handle = YarpProgram._on_connection

    def postpone(program: YarpProgram, number: int, event: ConnectionEvent) -> None:
        events.append((program, number, event))

    program = YarpProgram(names.client, "/program", Definitions(()))
    try:
        reader = program.subscribe("/said", STRING)
        monkeypatch.setattr(YarpProgram, "_on_connection", postpone)
        writer = program.advertise("/said", STRING, latched=True)
        program.publish(writer, {"data": "first"})
        for event in events:  # only now the program learns of the connection
            handle(*event)
        program.publish(writer, {"data": "second"})
        assert [message["data"] for message in program.wait(reader, 2)] == ["first", "second"]
    finally:
        program.stop()
