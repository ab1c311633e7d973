"""`RFModule`: lifecycle, commands, signals."""

from __future__ import annotations

import os
import signal
import threading
import time

import pytest

import yarp_compat as yarp
from tests.support.wait import until
from yarp_compat.ports import text_client

pytestmark = pytest.mark.usefixtures("local")


class Module(yarp.RFModule):
    def __init__(self, rounds: int = 10**9, period: float = 0.001) -> None:
        super().__init__()
        self.rounds, self.period, self.said = rounds, period, []

    def configure(self, rf: yarp.ResourceFinder) -> bool:
        self.said.append("configure")
        return not rf.check("fail")

    def getPeriod(self) -> float:
        return self.period

    def updateModule(self) -> bool:
        self.said.append("update")
        return self.said.count("update") < self.rounds

    def respond(self, command: yarp.Bottle, reply: yarp.Bottle) -> bool:
        if command.get(0).asString() == "help":
            reply.addVocab32("many")
            reply.addString("add two numbers")
            reply.append(yarp.Bottle("(quit 1) 2"))
            return True
        if command.get(0).asString() != "add":
            return False
        reply.addInt32(command.get(1).asInt32() + command.get(2).asInt32())
        return True

    def interruptModule(self) -> bool:
        self.said.append("interrupt")
        return True

    def close(self) -> bool:
        self.said.append("close")
        return True


def finder(*arguments: str) -> yarp.ResourceFinder:
    rf = yarp.ResourceFinder()
    rf.configure(["program", *arguments])
    return rf


def test_module_runs_until_update_returns_false() -> None:
    module = Module(rounds=3)
    assert module.runModule(finder()) == 0
    assert module.said == ["configure", "update", "update", "update", "close"]
    assert module.runModule() == 1  # a module runs only once


def test_unconfigured_module_does_not_run() -> None:
    module = Module()
    assert module.runModule(finder("--fail")) == 1
    assert module.said == ["configure"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_stop_the_module_at_once(number: int) -> None:
    before = signal.getsignal(number)
    module = Module(period=60.0)

    def stop() -> None:
        until(lambda: "update" in module.said, "the first cycle has run")
        os.kill(os.getpid(), number)

    thread = threading.Thread(target=stop)
    thread.start()
    begin = time.monotonic()
    assert module.runModule(finder()) == 0
    thread.join()
    assert time.monotonic() - begin < 30
    assert module.said == ["configure", "update", "interrupt", "close"]
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("interrupts", [True, False], ids=["", "cannot interrupt yet"])
def test_a_signal_while_the_module_is_configured_stops_it_afterwards(number: int, *, interrupts: bool) -> None:
    """YARP's ``RFModule`` catches signals from its creation on."""

    class Slow(Module):
        def configure(self, rf: yarp.ResourceFinder) -> bool:
            os.kill(os.getpid(), number)
            return super().configure(rf)

        def interruptModule(self) -> bool:
            super().interruptModule()
            if not interrupts:
                raise AttributeError("port")
            return True

    lost: list[int] = []
    before = signal.signal(number, lambda *_: lost.append(number))
    try:
        module = Slow(rounds=1)
        assert module.runModule(finder()) == 0
        assert (lost, module.said) == ([], ["interrupt", "configure", "close"])
        assert Slow().runModule(finder("--fail")) == 1
        os.kill(os.getpid(), number)
        assert lost == [number], "the program's own handler is back"
    finally:
        signal.signal(number, before)


def test_commands_are_answered() -> None:
    module, server, client = Module(), yarp.RpcServer(), yarp.RpcClient()
    module.attach(server)
    assert server.open("/module/rpc")
    assert client.open("/client")
    assert client.addOutput("/module/rpc")
    assert module.runModuleThreaded(finder()) == 0
    reply = yarp.Bottle()
    assert client.write(yarp.Bottle("add 2 3"), reply)
    assert reply.get(0).asInt32() == 5
    assert client.write(yarp.Bottle("dance"), reply)
    assert reply.toString() == '"command not recognized"'
    assert client.write(yarp.Bottle("[quit]"), reply)
    assert reply.get(0).asVocab32() == yarp.Vocab32.encode("bye")
    assert module.joinModule(10)
    assert module.isStopping()
    assert module.said[-2:] == ["interrupt", "close"]


def test_an_answer_with_many_lines_is_sent_in_each_carriers_form() -> None:
    """Text carriers send the answer as separate lines (as seen in telnet), binary ones as one Bottle."""
    module, port, client = Module(), yarp.Port(), yarp.RpcClient()
    module.attach(port)
    assert port.open("/module/rpc")
    assert text_client.ask(port.where().address, ["help"]) == ['"add two numbers"', "quit 1", "2"]
    assert text_client.ask(port.where().address, ["add", 2, 3]) == ["5"]
    assert client.open("/client")
    assert client.addOutput("/module/rpc")
    reply = yarp.Bottle()
    assert client.write(yarp.Bottle("help"), reply)
    assert reply.toString() == '[many] "add two numbers" (quit 1) 2'


def test_module_is_stopped_from_another_thread() -> None:
    module = Module(period=60.0)
    assert module.runModuleThreaded(finder()) == 0
    until(lambda: "update" in module.said, "a cycle has run")
    assert module.joinModule(0.01) is False
    module.stopModule(True)
    assert module.said[-1] == "close"


def test_ports_are_named_after_the_module() -> None:
    module = Module()
    module.setName("/nav")
    assert module.getName() == "/nav"
    assert module.getName("/rpc") == module.getName("rpc") == "/nav/rpc"


def test_cycles_follow_the_period() -> None:
    module = Module(rounds=6, period=0.02)
    begin = time.monotonic()
    module.runModule()
    assert time.monotonic() - begin >= 0.1
