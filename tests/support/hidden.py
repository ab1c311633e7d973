"""Hides what Python on Windows lacks, and has Windows' rules for file names."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path, PureWindowsPath

HIDE = """
import asyncio, concurrent.futures, http.client, logging.handlers, multiprocessing, numpy, os, select, selectors
import shutil, signal, socket, subprocess, sys, tempfile, time, urllib.request, uuid  # before they are hidden

for name in ("fcntl", "pwd", "grp", "resource", "termios", "tty", "pty", "syslog", "posix", "_posixsubprocess"):
    sys.modules[name] = None
for module, names in (
    (os, "fork forkpty getuid geteuid getgid getpgid killpg setsid mkfifo uname register_at_fork wait nice pipe2 "
         "fchmod sched_getaffinity getloadavg statvfs sysconf pread pwrite writev sendfile eventfd "
         "memfd_create pidfd_open O_NONBLOCK O_CLOEXEC"),
    (signal, "SIGHUP SIGKILL SIGUSR1 SIGUSR2 SIGPIPE SIGCHLD SIGQUIT SIGALRM pthread_sigmask sigwait alarm setitimer"),
    (socket, "AF_UNIX SO_REUSEPORT MSG_DONTWAIT MSG_NOSIGNAL CMSG_LEN send_fds recv_fds TCP_QUICKACK"),
    (select, "poll epoll POLLIN POLLRDHUP EPOLLIN EPOLLRDHUP"),
    (time, "clock_gettime clock_settime pthread_getcpuclockid"),
):
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)


def missing(self):
    raise AttributeError("Windows' sockets do not have it")


class Socket(socket.socket):
    sendmsg = recvmsg = recvmsg_into = property(missing)


def socketpair(*_):
    with socket.create_server(("127.0.0.1", 0)) as server:
        one = socket.create_connection(server.getsockname())
        return one, server.accept()[0]


socket.socket, socket.socketpair = Socket, socketpair
selectors.DefaultSelector = selectors.SelectSelector
"""
"""Code to run before yarp_compat is imported. It first imports the libraries that yarp_compat needs, because they use
what is hidden afterwards."""

LIBRARIES = """
import cryptography.x509, numpy, psutil, pydantic, rich.console, rosbags.typesys, ruamel.yaml, xxhash, yaml, zenoh
import os, types

whole = types.ModuleType("os")
vars(whole).update(vars(os))
for module in (psutil, psutil._common, psutil._pslinux, psutil._psposix):
    module.os = whole
"""
"""Code to run before `HIDE` in a process that also runs the bridge: imports the libraries that have separate code for
Windows. Here they run their Linux code, which needs what is hidden."""

ROOT = Path(__file__).parents[2]


def as_on(system: str, environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return an environment in which Midspan runs as on ``windows`` or ``macos``; see `tests.support.other_os`."""
    paths = [str(ROOT / "tests" / "support" / "other_os"), str(ROOT)]
    return {
        **environ,
        "HIDDEN_OS": system,
        "PYTHONWARNDEFAULTENCODING": "1",  # sitecustomize makes it an error in Midspan's modules
        "PYTHONPATH": os.pathsep.join(paths),
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }


def is_windows_name(name: str) -> bool:
    """Return whether Windows allows a file name in a folder, by the rules of `pathlib` and Microsoft."""
    path = PureWindowsPath("C:/maps") / name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        reserved = path.is_reserved()
    inside = path.parent == PureWindowsPath("C:/maps") and path.name == name
    signs = set('<>:"|?*') | {chr(code) for code in range(32)}
    return inside and not reserved and not set(name) & signs and name == name.rstrip(". ")
