"""``RFModule``: a program that is configured, updated periodically, answers commands, and stops on demand."""

from __future__ import annotations

import logging
import signal
import sys
import threading
from types import FrameType
from typing import Any

from yarp_compat.os import time as clock
from yarp_compat.os.data.bottle import Bottle, Value
from yarp_compat.os.ports.connection import ConnectionReader
from yarp_compat.os.resource_finder import ResourceFinder
from yarp_compat.os.thread import ended
from yarp_compat.overriding import override
from yarp_compat.wire.accessors import setter
from yarp_compat.wire.portable import PortReader

log = logging.getLogger("yarp.os.RFModule")

_QUIT = ("quit", "exit", "bye")
_FORCED = 4  # the number of signals that end the program at once


class RFModule:
    """The base class of modules, which override ``updateModule``.

    Example::

        class Follower(yarp.RFModule):
            def configure(self, rf):
                self.port = yarp.BufferedPortBottle()
                return self.port.open(rf.check("name", yarp.Value("/follower")).asString() + "/target:i")

            def getPeriod(self):
                return 0.1

            def updateModule(self):
                target = self.port.read(False)
                return True

            def interruptModule(self):
                self.port.interrupt()
                return True

            def close(self):
                self.port.close()
                return True

        rf = yarp.ResourceFinder()
        rf.configure(sys.argv)
        sys.exit(Follower().runModule(rf))

    SIGINT and SIGTERM stop the module cleanly: ``interruptModule`` is called, the loop ends, ``close`` is called.
    During ``configure``, the module ends when it returns. The fourth signal ends the program at once.
    """

    def __init__(self) -> None:
        self._stop = threading.Event()
        self._interrupting = threading.RLock()
        self._thread: threading.Thread | None = None
        self._ran = False
        self._name = ""
        self._responder = _Responder(self)
        self._signals = 0

    def configure(self, rf: ResourceFinder) -> bool:  # noqa: ARG002
        """Prepare the module; return False to end it."""
        return True

    def updateModule(self) -> bool:
        """Execute one cycle; return False to end the module."""
        raise NotImplementedError(f"{type(self).__name__} has no updateModule")

    def getPeriod(self) -> float:
        """Return the period of the cycles in seconds."""
        return 1.0

    def respond(self, command: Bottle, reply: Bottle) -> bool:
        """Answer a command; return False if it is unknown."""
        return self._basic_respond(command, reply)

    def interruptModule(self) -> bool:
        """Interrupt the ports that a cycle may wait for."""
        return True

    def close(self) -> bool:
        """Release the module's resources."""
        return True

    def attach(self, source: Any) -> bool:
        """Let ``respond`` answer the commands that this Port or RpcServer receives."""
        source.setReader(self._responder)
        return True

    attach_rpc_server = attach

    def attachTerminal(self) -> bool:
        """Let ``respond`` answer commands from the terminal, until the module stops or input ends."""
        threading.Thread(target=self._read_terminal, name="yarp-terminal", daemon=True).start()
        return True

    def detachTerminal(self) -> bool:
        """Return True: the terminal's thread ends with the module."""
        return True

    def safeRespond(self, command: Bottle, reply: Bottle) -> bool:
        """Call `respond`; if it returns False, handle ``quit``, ``exit`` and ``bye``."""
        return bool(self.respond(command, reply)) or self._basic_respond(command, reply)

    def runModule(self, rf: ResourceFinder | None = None) -> int:
        """Configure (if given a finder), and run until stopped; return 1 if that failed or the module ran before."""
        if self._ran:
            return 1
        before = self._catch_signals()
        try:
            if rf is not None and not self.configure(rf):
                log.info("RFModule failed to open.")
                return 1
            self._ran = True
            self._loop()
            log.info("RFModule closing.")
            with self._interrupting:
                self.close()
            log.info("RFModule finished.")
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        return 0

    def runModuleThreaded(self, rf: ResourceFinder | None = None) -> int:
        """Run in a new thread; return 0 once it is started, 1 if configuring failed or the module ran before."""
        if self._ran or self._thread is not None:
            return 1
        if rf is not None and not self.configure(rf):
            log.error("RFModule failed to open.")
            return 1
        self._thread = threading.Thread(target=self.runModule, name=f"yarp-module{self._name}", daemon=True)
        self._thread.start()
        return 0

    def joinModule(self, seconds: float = -1) -> bool:
        """Wait until the module's thread has ended; return False after ``seconds`` (negative: no limit)."""
        if self._thread is None:
            log.warning("Cannot call join: RFModule runModule() is not currently threaded.")
            return True
        if not ended(self._thread, seconds):
            log.warning("RFModule joinModule() timed out.")
            return False
        self._thread = None
        return True

    def stopModule(self, wait: bool = False) -> None:
        """End the loop after the current cycle, and call `interruptModule`; ``wait``: wait for the module's thread."""
        with self._interrupting:  # close() must wait for interruptModule()
            self._stop.set()
            if not self.interruptModule():
                log.error("interruptModule() returned an error there could be problems shutting down the module.")
        if wait:
            self.joinModule()

    def isStopping(self) -> bool:
        """Return whether the module is stopping."""
        return self._stop.is_set()

    def getName(self, subName: str = "") -> str:
        """Return the module's name, followed by a sub-name."""
        if subName and not subName.startswith("/"):
            log.warning('subName %s in getName() does not begin with "/", which is added', subName)
            subName = f"/{subName}"
        return self._name + subName

    setName = setter("_name", str, "Set the module's name.")

    def _loop(self) -> None:
        while not self.isStopping():
            began = clock.steady()
            if not self.updateModule():
                return
            # Waiting on the event lets a module with a long period stop at once.
            clock.wait(self._stop, self.getPeriod(), began)

    def _basic_respond(self, command: Bottle, reply: Bottle) -> bool:
        if command.get(0).toString().strip("[]") in _QUIT:
            reply.addVocab32("bye")
            self.stopModule(False)
            return True
        reply.addString("command not recognized")
        return False

    def _read_terminal(self) -> None:
        log.info('Listening to terminal (type "quit" to stop module).')
        for line in sys.stdin:
            reply = Bottle()
            if self.safeRespond(Bottle(line), reply):
                lines = reply if reply.get(0).toString() == "help" else [reply.toString()]
                for text in lines:
                    log.info("%s.", Value(text).toString())
            else:
                log.info("Command not understood -- %s.", line.strip())
            if self.isStopping():
                return

    def _catch_signals(self) -> dict[int, Any]:
        if threading.current_thread() is not threading.main_thread():
            return {}  # only the main thread may set handlers; the program stops a module in another thread
        return {number: signal.signal(number, self._on_signal) for number in (signal.SIGINT, signal.SIGTERM)}

    def _on_signal(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002
        self._signals += 1
        if self._signals >= _FORCED:
            log.error("Aborting after %d signals", self._signals)
            raise SystemExit(128 + number)
        log.info("[try %d of %d] Trying to shut down.", self._signals, _FORCED - 1)
        try:
            self.stopModule(False)
        except Exception:  # during `configure`, the module may not have what it interrupts
            log.exception("interruptModule() failed")


class _Responder(PortReader):
    """A reader that passes a port's commands to the module's `respond`."""

    def __init__(self, module: RFModule) -> None:
        super().__init__()
        self._module = module

    @override
    def read(self, connection: ConnectionReader) -> bool:
        command, reply = Bottle(), Bottle()
        if not command.read(connection):
            return False
        understood = self._module.safeRespond(command, reply)
        writer = connection.getWriter()
        if writer is not None and reply.size() > 0:
            if reply.get(0).toString() == "many" and writer.isTextMode():
                for value in reply.tail():
                    Bottle(value if isinstance(value, list) else [value]).write(writer)
            else:
                reply.write(writer)
        return understood
