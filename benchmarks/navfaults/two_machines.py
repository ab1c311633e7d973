"""The deployment on two machines: two network namespaces, joined by TLS over a link that can be cut."""

from __future__ import annotations

import copy
import socket
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml
from typing_extensions import override

from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.navigation.chain import Chain
from tests.support.netns import Cable, Machine
from tests.support.process import Process

_EXTERNAL_PORT = 7448
_SEEKS = "robot_path_planner"


class TwoMachines(Chain):
    """A robot, and an operator's computer with the client; the true pose is observed on the robot.

    This process connects to both hubs by sockets in the file system, which do not depend on the link.

    Args:
        folder: folder of its files.
        split: whether planner and gateway run on the operator's computer; all other modules always run on the robot.
    """

    def __init__(self, folder: Path, *, split: bool = False) -> None:
        super().__init__(folder)
        self.robot, self.operator = Machine("robot"), Machine("operator")
        self.cable = Cable(self.robot, self.operator, net=78)
        for machine in (self.robot, self.operator):
            machine.hosts(robot1=self.cable.addresses[0], **{socket.gethostname(): "127.0.0.1"})
        self._split = split
        self._far: Process | None = None

    @override
    def write(self) -> None:
        """Write both configurations."""
        robot, operator = copy.deepcopy(self.config), copy.deepcopy(self.config)
        for name, config in (("robot1", robot), ("operator1", operator)):
            config["name"] = name
            config["state"] = str(self.folder / name)
            ends = [config["hub"]["listen"], self._socket(name)]
            config["hub"]["router_zenoh"] = {"listen": {"endpoints": ends}}
        robot["hub"]["open"] = self._hub_open(listen=[f"tls/0.0.0.0:{_EXTERNAL_PORT}"], trusted=["operator1"])
        operator["hub"]["open"] = self._hub_open(connect=[f"tls/robot1:{_EXTERNAL_PORT}"], trusted=["robot1"])
        operator["sim"] = operator["yarp"] = {"enabled": False}
        robot_modules = operator.pop("modules")
        if self._split:
            del robot["navigation"], robot["modules"][_SEEKS]
            operator["modules"] = {_SEEKS: robot_modules[_SEEKS]}
            operator["navigation"]["map"] = "/map"
        else:
            del operator["navigation"]
        self.file.write_text(yaml.safe_dump(robot))
        self.far_file.write_text(yaml.safe_dump(operator))

    @property
    def far_file(self) -> Path:
        """Path of the operator's configuration."""
        return self.folder / "operator.yaml"

    @override
    def start(self) -> None:
        """Start both daemons, the client on the operator's hub, and the observer on the robot's hub."""
        for name in ("robot1", "operator1"):
            self.operator.run(*MIDSPAN, "keys", "make", name, "--folder", self.folder / "keys")
        self.write()
        self.daemon = self.robot.start(*MIDSPAN, "run", "--config", self.file)
        self._far = self.operator.start(*MIDSPAN, "run", "--config", self.far_file)
        self.client = self.join("client", self._socket("operator1"))
        self.listen(self.client, self.join("watcher", self._socket("robot1")))
        if self._split:
            self.until(lambda: self.status(_SEEKS).get("map"), "the map has arrived over the link", 40)

    @override
    def output(self) -> str:
        """Return the end of both logs."""
        return super().output() + (f"--- operator\n{self._far.output()[-8000:]}" if self._far else "")

    def _socket(self, name: str) -> str:
        return f"unixsock-stream/{self.folder / name}.sock"

    def _hub_open(self, **more: Any) -> dict[str, Any]:
        return {"keys": str(self.folder / "keys"), **more}

    @override
    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        super().__exit__(kind, err, tb)
        if self._far is not None:
            self._far.stop()
        for machine in (self.robot, self.operator):
            machine.close()
