"""A YARP program in a separate process that a test controls with JSON lines; see `tests.peers.peer`.

Arguments: the name server's address and port, the program's name. Commands: ``advertise``, ``publish``, ``subscribe``,
``wait``, ``drop``, ``join``. Midspan makes all connections: the program does not read the name server's list.
"""
# ruff: noqa: A002  # parameters are named as in the commands

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.contract.side import CUSTOM_FOLDER
from tests.peers.commands import Commands, only_answers, serve
from tests.peers.yarp.programs import Definitions, YarpProgram
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.os.ports.nested import NestedName


class Unconnected(YarpProgram):
    """A program that leaves all connections to Midspan."""

    def _connect(self, own: NestedName) -> None:
        pass


class Program(Commands):
    """The program's commands."""

    def __init__(self, program: YarpProgram) -> None:
        super().__init__()
        self._program = program

    def advertise(self, topic: str, type: str, **qos: Any) -> dict[str, Any]:
        return {"id": self._program.advertise(topic, type, **qos)}

    def subscribe(self, topic: str, type: str, **qos: Any) -> dict[str, Any]:
        return {"id": self._program.subscribe(topic, type, **qos)}

    def publish(self, id: int, message: dict[str, Any], times: int = 1) -> dict[str, Any]:
        self._program.publish(id, message, times)
        return {}

    def wait(self, id: int, count: int, seconds: float, since: int = 0) -> dict[str, Any]:
        return {"messages": self._program.wait(id, count, seconds)[since:]}

    def drop(self, id: int) -> dict[str, Any]:
        self._program.drop(id)
        return {}


def main() -> None:
    """Execute the commands from standard input, then close the program's ports."""
    host, number, name = sys.argv[1:]
    answers = only_answers()
    program = Unconnected(NameClient(Address(host, int(number))), name, Definitions((CUSTOM_FOLDER,)))
    serve(Program(program), answers)
    program.stop()


if __name__ == "__main__":
    main()
