"""An isolated environment for one run of the demo: free ports, a separate ROS domain and folder."""

from __future__ import annotations

import http.client
import os
import random
import shutil
import socket
import tempfile
import xmlrpc.client
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml

import bridge
from bridge import kernels
from bridge.adapters.ros2 import environment as ros2
from bridge.config.load import load
from bridge.config.model import Config
from bridge.config.sections.section import EMBEDDED
from bridge.demo.rospy_packages import missing_rospy, packages_folder
from bridge.shipped import shipped_folder

MARK = "MIDSPAN_DEMO"
"""Environment variable of all processes of one run; its value is the run's folder."""

_ROOT = Path(bridge.__file__).parents[1]
CONFIG = shipped_folder() / "configs" / "demo.yaml"

_SETTINGS = ("FASTDDS_", "FASTRTPS_", "MIDSPAN_", "RMW_", "ROS_", "YARP_", "ZENOH_")
"""Prefixes of the variables with which a user configures Midspan and the middlewares; a demo ignores them."""

_KEPT = {"MIDSPAN_CACHE"}
"""The variable that a demo does not ignore; it names the folder of built message packages."""

_LONGEST_BASE = 50  # characters of the default temporary folder's path
_DOMAINS = range(10, 101)
_PORT_BASE, _DOMAIN_GAIN = 7400, 250  # DDSI-RTPS 2.5, 9.6.2.4: ports of a domain
_TCP_BASE, _TCP_EACH = 30_000, 20
"""First TCP port, and TCP ports per domain; all are below the ports that Linux assigns to outgoing connections (from
32768), which could occupy a server's port."""


class Sandbox:
    """Ports, ROS domain, folder and configuration of one run.

    The configuration is the file ``template``, overridden by ``more`` and by the sandbox's addresses. ``ports``:
    whether topics have the YARP ports that the demo's YARP program expects; ``yarp``: whether there is a YARP network.
    """

    def __init__(
        self, template: Path | None, more: Mapping[str, Any] | None = None, *, ports: bool = True, yarp: bool = True
    ) -> None:
        self._hold: socket.socket | None = None
        self.folder = Path(tempfile.mkdtemp(prefix="midspan-demo-", dir=_base()))
        try:
            self._hold, self.domain = hold_domain()
            self.master_port, self.router_port, self.yarp_port, self.web_port = free_ports(4, self.domain)
            # a folder with only this package, whose neighbors must not be visible to the system's Python
            self.system_path = self.folder / "system"
            self.system_path.mkdir()
            (self.system_path / "bridge").symlink_to(Path(bridge.__file__).parent)
            self.config_file = self.folder / "demo.yaml"
            self.config = self._write_config(template, more or {}, ports=ports and yarp, yarp=yarp)
        except BaseException:
            self.close()
            raise

    @property
    def master(self) -> str:
        """URI of the ROS master."""
        return f"http://127.0.0.1:{self.master_port}/"

    @property
    def domain_ports(self) -> range:
        """The ports of the ROS domain."""
        return _ports(self.domain)

    def master_answers(self) -> bool:
        """Return whether the ROS master is up, including its ``/run_id``; a rospy program that starts earlier fails."""
        try:
            with xmlrpc.client.ServerProxy(self.master) as proxy:
                answer: Any = proxy.hasParam("/demo", "/run_id")
        except (OSError, xmlrpc.client.Error, http.client.HTTPException):
            return False
        return bool(answer[0] == 1 and answer[2])

    def environment(self) -> dict[str, str]:
        """Return the environment of the daemon and of the programs on Midspan's own Python."""
        inherited = {k: v for k, v in os.environ.items() if not k.startswith(_SETTINGS) or k in _KEPT}
        return inherited | {
            MARK: str(self.folder),
            "ROS_MASTER_URI": self.master,
            "ROS_IP": "127.0.0.1",
            "ROS_DOMAIN_ID": str(self.domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_HOME": str(self.folder / "ros"),
            "YARP_CONFIG_HOME": str(self.folder / "yarp"),
            "ROS_LOG_DIR": str(self.folder / "log"),
            "PYTHONUNBUFFERED": "1",
            # for running from a checkout that is not installed
            "PYTHONPATH": os.pathsep.join(filter(None, [inherited.get("PYTHONPATH"), str(_ROOT)])),
        }

    def ros1_environment(self) -> dict[str, str]:
        """Return the environment of roscore and of ROS 1 programs, which run on the system's Python."""
        packages = ros1_packages(self.config)
        drop = ("LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "VIRTUAL_ENV", "PYTHONHOME", "ROS_DOMAIN_ID")
        env = {k: v for k, v in self.environment().items() if k not in drop}
        env["PATH"] = os.pathsep.join([str(packages.parents[2] / "bin"), "/usr/bin", "/bin"])
        paths = [self.system_path] if str(packages).startswith("/usr/") else [self.system_path, packages]
        env["PYTHONPATH"] = os.pathsep.join(map(str, paths))
        return env

    def close(self) -> None:
        """Release the domain, and remove the folder."""
        if self._hold is not None:
            self._hold.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _write_config(self, template: Path | None, more: Mapping[str, Any], *, ports: bool, yarp: bool) -> Config:
        base: dict[str, Any] = {}
        if template is not None:
            load(template)  # reports errors with file and line
            base = yaml.safe_load(template.read_text(encoding="utf-8")) or {}
        base = _merged(base, more)
        if ports and not (base.get("yarp") or {}).get("topics"):  # as the demo's YARP program expects
            shipped = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))["yarp"]
            base = _merged(base, {"yarp": shipped})
        addresses = {
            "name": f"demo-{os.getpid()}",
            "state": str(self.folder / "state"),
            "hub": {"listen": f"tcp/127.0.0.1:{self.router_port}", "domain": self.domain, "router": True},
            "ros1": {"enabled": True, "master": self.master},
            "ros2": {"enabled": True, "domain": self.domain},
            "yarp": {"enabled": yarp, "nameserver": "embedded", "address": f"127.0.0.1:{self.yarp_port}"},
            "web": {"listen": f"127.0.0.1:{self.web_port}"},
        }
        return self._written(_merged(base, addresses))

    def _written(self, document: dict[str, Any]) -> Config:
        self.config_file.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        return load(self.config_file)

    def embed_master(self) -> None:
        """Let Midspan run the ROS 1 master, for a machine without roscore."""
        document = yaml.safe_load(self.config_file.read_text(encoding="utf-8"))
        ros1 = {"master": EMBEDDED, "listen": f"127.0.0.1:{self.master_port}"}
        self.config = self._written(_merged(document, {"ros1": ros1}))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.close()


def _base() -> str | None:
    """Return /tmp if the default folder's path is so long that the daemon's socket names would be too long."""
    short = Path("/tmp")  # noqa: S108 - mkdtemp creates a private folder in it
    return str(short) if len(tempfile.gettempdir()) > _LONGEST_BASE and short.is_dir() else None


def _merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = _merged(below or {}, value) if isinstance(value, Mapping) else value
    return merged


def free_ports(count: int, domain: int) -> list[int]:
    """Return free TCP ports from the range of a held domain, which other demos do not use."""
    first = _TCP_BASE + _TCP_EACH * domain
    ports = [port for port in range(first, first + _TCP_EACH) if _is_free(port, socket.SOCK_STREAM)][:count]
    if len(ports) < count:
        raise RuntimeError(f"too few free TCP ports between {first} and {first + _TCP_EACH - 1} on this machine")
    return ports


def hold_domain() -> tuple[socket.socket, int]:
    """Return an unused ROS domain, held by a socket on the last of its ports, which participants do not use."""
    domains = list(_DOMAINS)
    random.shuffle(domains)
    for domain in domains:
        ports = _ports(domain)
        if not _is_free(ports[0]) or not _is_free(ports[10]):  # discovery ports: multicast, and the first participant's
            continue
        hold = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            hold.bind(("127.0.0.1", ports[-1]))
        except OSError:
            hold.close()
            continue
        return hold, domain
    raise RuntimeError(f"no free ROS domain between {_DOMAINS.start} and {_DOMAINS.stop - 1} on this machine")


def _ports(domain: int) -> range:
    first = _PORT_BASE + _DOMAIN_GAIN * domain
    return range(first, first + _DOMAIN_GAIN)


def _is_free(port: int, kind: socket.SocketKind = socket.SOCK_DGRAM) -> bool:
    with socket.socket(socket.AF_INET, kind) as sock:
        try:
            sock.bind(("", port))
        except OSError:
            return False
    return True


SYSTEM_PYTHON = Path("/usr/bin/python3")
"""The Python for which ROS 1's packages are installed."""

ROBOT = ("nav_msgs", "sensor_msgs", "geometry_msgs", "tf2_msgs")
"""The packages that the simulated ROS 1 robot imports in addition to rospy."""

CLIENT = ("actionlib", "actionlib_msgs", "geometry_msgs", "move_base_msgs", "visualization_msgs")
"""The packages that the rospy client imports in addition to rospy."""


def missing(config: Config) -> list[str]:
    """Return what ROS 2 and zenoh lack on this machine, each with its cure; empty if the demo can run."""
    return [reason for reason in (_ros2(config), _zenoh()) if reason]


def too_slow() -> list[str]:
    """Return why driving would be too slow, with the cure; empty if all kernels are compiled."""
    state = kernels.state()  # the demo also needs the kernels of the simulator, the localizer and the ROS 2 side
    return [f"kernels: {state}: {kernels.CURE}"] if state.missing else []


def ros1_packages(config: Config) -> Path:
    """Return the folder of ROS 1's Python packages; only valid if rospy is installed."""
    folder = packages_folder(config, os.environ)
    assert folder is not None
    return folder


def roscore(config: Config) -> Path | None:
    """Return the path of ``roscore``; None if it or rospy is not installed."""
    folder = packages_folder(config, os.environ)
    if folder is None:
        return None
    program = shutil.which("roscore", path=f"{folder.parents[2] / 'bin'}:{os.environ.get('PATH', '')}")
    return Path(program) if program is not None else None


def without_rospy(config: Config, packages: Sequence[str]) -> str:
    """Return which of rospy and ``packages`` are missing, with the cure; "" if none is."""
    reason = missing_rospy(config, os.environ)
    if reason:
        return f"ROS 1: {reason}"
    folder = ros1_packages(config)
    lacking = [name for name in packages if not (folder / name).is_dir()]
    debian = " ".join(f"python3-{name.replace('_', '-')}" for name in lacking)
    return f"ROS 1: {folder} lacks {', '.join(lacking)}: apt install {debian}" if lacking else ""


def _ros2(config: Config) -> str:
    reason = ros2.available(config)
    if reason:
        return f"ROS 2: {reason}"
    if find_spec("tf2_msgs") is None:
        return "ROS 2: no message package tf2_msgs for this Python: midspan interfaces build"
    return ""


def _zenoh() -> str:
    if find_spec("zenoh_ros2_sdk") is None:
        return "zenoh: no zenoh-ros2-sdk for this Python: pip install zenoh-ros2-sdk==0.1.8"
    return ""
