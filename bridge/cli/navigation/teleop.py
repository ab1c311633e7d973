"""``midspan teleop``: drives a base with the keyboard."""

from __future__ import annotations

import argparse
import math
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Collection
from typing import NamedTuple

from bridge.cli.arguments import add_hub_arguments
from bridge.cli.client import open_client, warn_of_refusals
from bridge.cli.graph.goal import Interrupt, Interrupted
from bridge.cli.keyboard import AVAILABLE, pressed, raw
from bridge.cli.output import CliError
from bridge.client.graph import absolute
from bridge.client.manual import ManualControl, on_halt
from bridge.client.types import Types
from bridge.client.velocity import STOP_SECONDS, VelocityForm, VelocityPublisher, open_velocity
from bridge.clock import steady
from bridge.config.sections.section import Enabled
from bridge.text import clean

RATE = 20.0
HOLD_SECONDS = 0.6
"""Seconds for which a key counts as held after it arrives: keyboards repeat a held key only after half a second."""

STALL_SECONDS = 0.5
"""After a longer pause between two reads of the terminal, keys may have waited in it."""

STEP = 1.1
MAX_SPEED, MAX_TURN = 2.0, 3.0

KEYS = {
    "i": (1, 0, 0), ",": (-1, 0, 0), "j": (0, 0, 1), "l": (0, 0, -1), "u": (1, 0, 1), "o": (1, 0, -1),
    "m": (-1, 0, -1), ".": (-1, 0, 1), "J": (0, 1, 0), "L": (0, -1, 0),
    "\x1b[A": (1, 0, 0), "\x1b[B": (-1, 0, 0), "\x1b[D": (0, 0, 1), "\x1b[C": (0, 0, -1),
}  # fmt: skip
"""The keys of ROS's teleop_twist_keyboard, and arrows: forward, to the left, turning to the left."""

_STAMPED: dict[str, Enabled] = {"auto": "auto", "true": True, "false": False}

HELP = """\
   u  i  o      forward, with a turn to the left and right      (arrow keys, too)
   j  k  l      turn on the spot; k or space: stop
   m  ,  .      backward
   J     L      to the side (holonomic bases)
   q / z: faster / slower    Ctrl-C or x: end
The base stops when no key is held."""


class HeldKeys(NamedTuple):
    """The velocity that the held keys request, as shares of the speeds: forward, left and turning left."""

    forward: int = 0
    left: int = 0
    turn: int = 0


class Keys:
    """The velocity that the pressed keys request, in m/s and rad/s; ``zeros``: how often zero is to be published.

    `press` gets all keys of one read of the terminal, and `tick` follows each period in which it was read. A terminal
    does not report that a key is released, only that no key arrives. Silence is counted in calls of `tick`, because
    nothing is read while this process stalls.
    """

    def __init__(self, speed: float, turn: float) -> None:
        self.speed, self.turn = speed, turn
        self.ended = False
        self.zeros = 1
        self._wish = HeldKeys()
        self._until = 0.0
        self._ticked_at = math.inf
        self._left = 0  # calls of `tick` until the key that was held at the last halt or refusal counts as released
        self._halted = False  # until a key drives again

    def press(self, keys: Collection[str], now: float) -> None:
        """Handle the keys of one read, at a time in seconds.

        After a halt, several keys at once are no new press: the terminal was silent because they were delayed.
        """
        moves = [key for key in keys if key in KEYS]
        if moves and (self._left or (self._halted and len(moves) > 1)):
            self._left = self._release_ticks
        elif moves and not self._stalled(now):  # otherwise the key may have been released long ago
            self._wish, self._until, self._halted = HeldKeys(*KEYS[moves[-1]]), now + HOLD_SECONDS, False
        for key in keys:
            if key in "qz":
                factor = STEP if key == "q" else 1.0 / STEP
                self.speed, self.turn = min(self.speed * factor, MAX_SPEED), min(self.turn * factor, MAX_TURN)
            elif key not in KEYS:
                self._wish = HeldKeys()  # any other key stops the base
                self.ended = self.ended or key in ("x", "\x03", "\x04")

    def tick(self, now: float) -> None:
        """Count a period in which the terminal was read; after a stall, count silence from the beginning."""
        if self._left:
            self._left = self._release_ticks if self._stalled(now) else self._left - 1
        self._ticked_at = now

    def _stalled(self, now: float) -> bool:
        """Return whether the keys that are read now may have waited for long."""
        return now > self._ticked_at + STALL_SECONDS

    @property
    def _release_ticks(self) -> int:
        return math.ceil(HOLD_SECONDS * RATE) + 1

    def halt(self) -> None:
        """Stop; a key that is held must be released before it drives again."""
        self._wish, self._left, self._halted = HeldKeys(), self._release_ticks, True

    @property
    def blocked(self) -> bool:
        """Whether a key that may be held must be released first."""
        return self._left > 0

    def velocity(self, now: float) -> tuple[float, float, float]:
        """Return the velocity at a time, m/s and rad/s: zero unless a key is held."""
        held = self._wish if now <= self._until and not self.ended else HeldKeys()
        return held.forward * self.speed, held.left * self.speed, held.turn * self.turn


def register(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Drives a base on any side with the keyboard: publishes velocities on the hub while a key is held, then zero"
        " for a moment, and nothing until the next key."
    )
    parser.epilog = HELP
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--topic", default="/cmd_vel", help="the velocity topic (default /cmd_vel)")
    parser.add_argument(
        "--stamped",
        choices=_STAMPED,
        help="publish TwistStamped, or Twist; auto: the type that the base subscribes to (default: navigation.stamped)",
    )
    parser.add_argument("--speed", type=float, default=0.2, metavar="M/S", help="initial speed (default 0.2)")
    parser.add_argument(
        "--turn", type=float, default=0.5, metavar="RAD/S", help="initial angular velocity (default 0.5)"
    )
    add_hub_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive until Ctrl-C, ``x``, SIGTERM or SIGHUP."""
    if not (0.0 < args.speed <= MAX_SPEED and 0.0 < args.turn <= MAX_TURN):
        raise CliError(f"--speed is at most {MAX_SPEED:g} m/s and --turn at most {MAX_TURN:g} rad/s, both above 0")
    if not (AVAILABLE and sys.stdin.isatty()):
        raise CliError("teleop reads keys only from a POSIX terminal; 'midspan topic pub' publishes from scripts")
    topic = absolute(args.topic)
    code = 0
    with open_client(args) as client, Interrupt() as interrupt:
        section, types = client.config.navigation, Types(client)
        form = VelocityForm(topic, _STAMPED.get(args.stamped, section.stamped), section.base_frame)
        publisher = open_velocity(client, types, form, _warn)
        warn_of_refusals(client, [(topic, publisher.type_name, types.hash_of(publisher.type_name))])
        print(HELP, flush=True)
        driver = Driver(Keys(args.speed, args.turn), publisher, ManualControl(client.hub, topic))
        end = on_halt(client.hub, driver.halt)
        try:
            with raw(sys.stdin.fileno()) as terminal:
                _drive(driver, topic, terminal, interrupt.check)
        except Interrupted as err:
            code = 0 if err.number == signal.SIGINT else err.code
        finally:
            driver.stop()
            end()
            publisher.close()
            print()
    return code


def _warn(text: str) -> None:
    print(f"\nmidspan: warning: {clean(text)}", file=sys.stderr)


class Driver:
    """Publishes what the keys request, unless another person drives manually. `halt` may be called on any thread."""

    def __init__(self, keys: Keys, publisher: VelocityPublisher, control: ManualControl) -> None:
        self.keys = keys
        self._publisher, self._control = publisher, control
        self._who = f"midspan teleop ({socket.gethostname()})"
        self._lock = threading.Lock()  # so that no velocity follows a confirmed halt

    def press(self, keys: Collection[str]) -> None:
        """Handle the keys of one read of the terminal."""
        with self._lock:
            self.keys.press(keys, steady())

    def halt(self) -> None:
        """Stop until the key is released."""
        with self._lock:
            self.keys.halt()

    @property
    def type_name(self) -> str:
        """The type of the velocities, which changes with the base's subscription."""
        return self._publisher.type_name

    def publish(self) -> str:
        """Publish the velocity that the keys request, or zero for a moment; return what to show."""
        self._publisher.follow()
        with self._lock:
            now = steady()
            self.keys.tick(now)
            x, y, turn = velocity = self.keys.velocity(now)
            if rival := self._control.rival():
                if any(velocity):  # a key that is held must not drive once the other person ends
                    self.keys.halt()
                if self._control.held:  # both began at the same moment
                    self._publisher.publish()
                self._control.end()
                self.keys.zeros = 0  # they would slow the other
                return f"{clean(rival)}{': not driving' if self.keys.blocked else ''}"
            if any(velocity):
                self._control.begin(self._who)
                self.keys.zeros = round(STOP_SECONDS * RATE)
                self._publisher.publish(*velocity)
            else:
                self._control.end()
                if self.keys.zeros:  # then silence, so that others can drive
                    self.keys.zeros -= 1
                    self._publisher.publish()
                if self.keys.blocked:
                    return "stopped: release the key first"
        return f"x {x:+.2f} y {y:+.2f} m/s, turn {turn:+.2f} rad/s"

    def stop(self) -> None:
        """Repeat zero for a moment after driving, unless another person drives."""
        self.keys.ended = True
        self.keys.zeros += 1
        while self.keys.zeros:
            self.publish()
            time.sleep(1.0 / RATE if self.keys.zeros else 0.0)


def _drive(driver: Driver, topic: str, terminal: int, check: Callable[[], None]) -> None:
    due, keys, shown = time.monotonic(), driver.keys, ""
    while not keys.ended:
        check()
        driver.press(list(pressed(terminal, max(0.0, due - time.monotonic()))))
        if time.monotonic() < due:
            continue
        due = max(due + 1.0 / RATE, time.monotonic())
        now = driver.publish()
        if driver.type_name != shown:
            shown = driver.type_name
            print(f"\r\x1b[K{topic} ({shown}):", flush=True)
        print(f"\r\x1b[K{now}   (speed {keys.speed:.2f}, turn {keys.turn:.2f}) ", end="", flush=True)
