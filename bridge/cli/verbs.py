"""The verbs of ``midspan``: each is one file of this folder, imported only when it is used.

A verb's module has ``register(subparsers)``, which adds its parser, and ``run(args) -> int``, the exit code.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Verb:
    """One verb.

    Attributes:
        module: where its code is.
        help: one line for ``midspan --help``.
    """

    module: str
    help: str


VERBS: dict[str, Verb] = {
    "run": Verb("bridge.cli.run", "run the daemon: start, watch and restart the workers"),
    "worker": Verb("bridge.cli.worker", "run one worker alone, also on another machine"),
    "module": Verb("bridge.cli.module", "run one hosted module alone, also on another machine"),
    "sim": Verb("bridge.cli.sim", "run the simulated base alone; make maps and pictures of floor plans"),
    "status": Verb("bridge.cli.status", "show daemons, workers and routes"),
    "top": Verb("bridge.cli.top", "live table of all routes"),
    "explain": Verb("bridge.cli.explain", "say why a topic is or is not bridged"),
    "doctor": Verb("bridge.cli.doctor", "look for what commonly goes wrong, and say the cure"),
    "topic": Verb("bridge.cli.topic", "list, info, echo, hz and pub on any side's topics"),
    "service": Verb("bridge.cli.service", "list, info and call on any side's services"),
    "action": Verb("bridge.cli.action", "list, info and send on any side's actions"),
    "tf": Verb("bridge.cli.tf", "list, tree, echo and monitor of frames"),
    "map": Verb("bridge.cli.map", "list, show, import, export, edit-flags and use of the stored maps"),
    "location": Verb("bridge.cli.location", "list, add, remove and export of the stored locations"),
    "goto": Verb("bridge.cli.goto", "drive to a place or a pose"),
    "nav": Verb("bridge.cli.nav", "status, stop, pause, resume, path and show of what drives the robot"),
    "teleop": Verb("bridge.cli.teleop", "drive a base by the keyboard"),
    "halt": Verb("bridge.cli.halt", "zero velocity on every side, and all goals cancelled"),
    "yarp": Verb("bridge.cli.yarp", "look at and use a YARP network, as YARP's own tool does"),
    "config": Verb("bridge.cli.config", "check a configuration file; print its schema or an example"),
    "import": Verb("bridge.cli.import_config", "turn another bridge's configuration into ours"),
    "interfaces": Verb("bridge.cli.interfaces", "build ROS 2 message packages that are missing"),
    "keys": Verb("bridge.cli.keys", "make and show the certificates by which machines know each other"),
    "install": Verb("bridge.cli.install", "put the systemd services in place"),
    "demo": Verb("bridge.cli.demo", "a simulated robot sent to rooms by YARP, ROS 1 and ROS 2 clients"),
    "completion": Verb("bridge.cli.completion", "print a shell completion script"),
}
