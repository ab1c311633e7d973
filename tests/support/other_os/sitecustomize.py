"""Makes each Python process with this folder on ``PYTHONPATH`` run Midspan as on Windows or macOS.

With ``HIDDEN_OS=windows`` or ``macos``, Midspan's own modules get restricted modules of the standard library: names
that the other system lacks are missing, and functions that differ there behave as there. Libraries get the real
modules, because they are adapted to each system. Compiled kernels are not loaded, because no other system has them.
"""

from __future__ import annotations

import builtins
import os
import select
import selectors
import signal
import socket
import stat
import subprocess
import sys
import types
import warnings
from pathlib import Path
from typing import Any

SYSTEM = os.environ.get("HIDDEN_OS", "")
OURS = ("bridge", "navigation", "sim", "yarp_compat")

NO_MODULES = {
    "windows": {
        "fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty", "_posixsubprocess", "readline",
    },
    "macos": {"spwd", "ossaudiodev"},
}  # fmt: skip
NO_NAMES = {
    "windows": {
        "os": "fork forkpty getuid geteuid getgid getegid getgroups getpgid getpgrp getsid killpg setsid setpgid mkfifo"
        " uname register_at_fork wait wait3 wait4 waitid waitpid WNOHANG nice pipe2 fchmod fchown chown sched_*"
        " getloadavg statvfs fstatvfs sysconf pread preadv pwrite pwritev sendfile splice copy_file_range eventfd*"
        " memfd_create getrandom posix_* O_NONBLOCK O_CLOEXEC O_DIRECTORY O_NOFOLLOW O_PATH O_TMPFILE EFD_* P_PID"
        " WEXITED WNOWAIT getresuid setuid setgid initgroups ctermid openpty ttyname pidfd_open getpriority setpriority"
        " PRIO_* fchdir fdatasync readv writev mknod lockf F_LOCK O_SYNC O_DSYNC O_NOCTTY get_blocking set_blocking",
        "signal": "SIGHUP SIGKILL SIGUSR* SIGPIPE SIGCHLD SIGQUIT SIGALRM SIGCONT SIGSTOP SIGTSTP SIGWINCH SIGIO"
        " SIGPOLL SIGRT* pthread_sigmask pthread_kill sigwait* sigtimedwait sigpending alarm setitimer getitimer pause"
        " siginterrupt",
        "socket": "AF_UNIX AF_NETLINK AF_PACKET AF_VSOCK SO_REUSEPORT SO_PEERCRED SO_BINDTODEVICE SO_MARK SO_DOMAIN"
        " SO_PROTOCOL MSG_DONTWAIT MSG_NOSIGNAL MSG_ERRQUEUE CMSG_* SCM_* send_fds recv_fds TCP_QUICKACK TCP_INFO"
        " TCP_USER_TIMEOUT TCP_CORK SOCK_NONBLOCK SOCK_CLOEXEC IP_RECVERR IP_PKTINFO sethostname",
        "select": "poll epoll EPOLL* POLL*",
        "selectors": "PollSelector EpollSelector DevpollSelector KqueueSelector",
        "time": "clock_gettime clock_gettime_ns clock_settime pthread_getcpuclockid CLOCK_* tzset",
        "faulthandler": "register unregister",
        "shutil": "chown",
    },
    "macos": {
        "os": "sched_* waitid P_PID WEXITED WNOWAIT pipe2 eventfd* EFD_* memfd_create MFD_* getrandom splice"
        " copy_file_range O_PATH O_TMPFILE O_DIRECT O_NOATIME posix_fadvise posix_fallocate pidfd_open getresuid"
        " getresgid setresuid getxattr setxattr listxattr unshare setns CLONE_*",
        "signal": "SIGRT* SIGPWR SIGSTKFLT SIGPOLL SIGCLD sigwaitinfo sigtimedwait",
        "socket": "AF_NETLINK AF_PACKET AF_VSOCK AF_CAN SO_PEERCRED SO_BINDTODEVICE SO_MARK SO_DOMAIN SO_PROTOCOL"
        " SO_PASSCRED SCM_CREDENTIALS MSG_NOSIGNAL MSG_ERRQUEUE TCP_KEEPIDLE TCP_QUICKACK TCP_USER_TIMEOUT TCP_INFO"
        " TCP_CORK SOCK_NONBLOCK SOCK_CLOEXEC IP_RECVERR IP_PKTINFO",
        "select": "epoll EPOLL*",
        "selectors": "EpollSelector DevpollSelector",
        "time": "pthread_getcpuclockid CLOCK_BOOTTIME CLOCK_TAI CLOCK_MONOTONIC_COARSE clock_settime",
        "resource": "prlimit RLIMIT_SIGPENDING RLIMIT_MSGQUEUE RLIMIT_NICE RLIMIT_RTPRIO RUSAGE_THREAD",
    },
}
"""The missing names by module; a star stands for any ending. macOS has ``os.waitid`` from Python 3.13 on."""

NO_FOLDERS = ("/proc", "/dev/shm", "/sys", "/run", "/dev/fd", "/usr/share/zoneinfo", "/etc")
"""The folders that are missing on simulated Windows; on simulated macOS, only the first four are missing."""

_replaced: dict[str, dict[str, object]] = {}
_proxies: dict[str, types.ModuleType] = {}


class Restricted(types.ModuleType):
    """A module without the names that the other system lacks; assignments go to the real module."""

    def __init__(self, module: types.ModuleType) -> None:
        hidden = NO_NAMES[SYSTEM].get(module.__name__, "").split()
        replaced = _replaced.get(module.__name__, {})
        set_own = object.__setattr__
        set_own(self, "_module", module)
        set_own(self, "_exact", {name for name in hidden if name[-1] != "*"})
        set_own(self, "_starts", tuple(name[:-1] for name in hidden if name[-1] == "*"))
        set_own(self, "_own", replaced)

    def __getattribute__(self, name: str) -> object:
        get_own = object.__getattribute__
        module = get_own(self, "_module")
        if name == "__dict__":
            hidden = get_own(self, "_exact"), get_own(self, "_starts")
            return {
                **{k: v for k, v in vars(module).items() if k not in hidden[0] and not k.startswith(hidden[1] or "\0")},
                **get_own(self, "_own"),
            }
        if name in get_own(self, "_own"):
            return get_own(self, "_own")[name]
        if name in get_own(self, "_exact") or (get_own(self, "_starts") and name.startswith(get_own(self, "_starts"))):
            raise AttributeError(f"module {module.__name__!r} has no attribute {name!r} on {SYSTEM}")
        return getattr(module, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(object.__getattribute__(self, "_module"), name, value)

    def __dir__(self) -> list[str]:
        return list(self.__dict__)


def is_ours(scope: object) -> bool:
    """Return whether globals belong to a module of Midspan."""
    if not isinstance(scope, dict):
        return False
    package = scope.get("__package__") or scope.get("__name__") or ""
    return package.partition(".")[0] in OURS


def restrict() -> None:
    """Give Midspan's modules the restricted modules."""
    original = builtins.__import__
    restricted = {*NO_NAMES[SYSTEM], *_replaced}

    def import_(name: str, scope: Any = None, local: Any = None, fromlist: Any = (), level: int = 0) -> Any:
        if level or not is_ours(scope):
            return original(name, scope, local, fromlist, level)
        top = name.partition(".")[0]
        if name in NO_MODULES[SYSTEM]:
            raise ModuleNotFoundError(f"No module named {name!r} on {SYSTEM}", name=name)
        if name == "msvcrt" and SYSTEM == "windows":
            return _msvcrt()
        module = original(name, scope, local, fromlist, level)
        wanted = name if fromlist else top
        return _proxy(module) if wanted in restricted else module

    builtins.__import__ = import_


def _proxy(module: types.ModuleType) -> types.ModuleType:
    name = module.__name__
    if name not in _proxies:
        _proxies[name] = Restricted(module)
    return _proxies[name]


def without_kernels() -> None:
    """Hide Midspan's compiled kernels, so that Python runs their sources."""
    from importlib import machinery

    class Uncompiled:
        @staticmethod
        def find_spec(name: str, path: Any = None, target: Any = None) -> Any:  # noqa: ARG004
            if name.partition(".")[0] not in OURS or path is None:
                return None
            finders = [
                machinery.FileFinder(folder, (machinery.SourceFileLoader, machinery.SOURCE_SUFFIXES)) for folder in path
            ]
            return next((spec for finder in finders if (spec := finder.find_spec(name)) is not None), None)

    sys.meta_path.insert(0, Uncompiled)


def named_encodings() -> None:
    """Make Midspan fail if it opens a text file without an encoding, because Windows' default is not UTF-8."""
    warnings.filterwarnings("ignore", category=EncodingWarning)
    warnings.filterwarnings("error", category=EncodingWarning, module=rf"({'|'.join(OURS)})\b")


# -- what behaves differently ------------------------------------------------------------------------------------------


def _calls_midspan(depth: int = 2) -> bool:
    """Return whether Midspan's code is calling, with only the standard library between it and this function."""
    try:
        frame = sys._getframe(depth)
    except ValueError:  # Python itself opens its program
        return False
    while frame is not None:
        name = frame.f_globals.get("__name__", "")
        if is_ours(frame.f_globals):
            return True
        if "site-packages" in frame.f_code.co_filename or name.startswith("importlib"):
            return False
        frame = frame.f_back
    return False


def _lacks(path: object) -> bool:
    if isinstance(path, int) or not isinstance(path, str | bytes | os.PathLike):
        return False
    text = os.fsdecode(path)
    folders = NO_FOLDERS if SYSTEM == "windows" else NO_FOLDERS[:-3]
    return text.startswith("/") and any(text == folder or text.startswith(f"{folder}/") for folder in folders)


_FORBIDDEN = set('<>:"|?*')
_DEVICES = {"CON", "PRN", "AUX", "NUL", *(f"{port}{n}" for port in ("COM", "LPT") for n in range(1, 10))}


def _check_name(path: object) -> None:
    """Raise the error that Windows raises for a file name that it forbids."""
    if isinstance(path, int) or not isinstance(path, str | bytes | os.PathLike):
        return
    for part in os.fsdecode(path).split("/"):
        bad = set(part) & _FORBIDDEN or (part.strip(".") and part[-1:] in {".", " "})
        if bad or part.partition(".")[0].rstrip().upper() in _DEVICES:
            raise OSError(
                22, f"{SYSTEM}: the file name, directory name, or volume label syntax is incorrect", str(path)
            )


def _check_closed(path: Any) -> None:
    """Raise the error that Windows raises if a removed or replaced file is open in this process."""
    try:
        at = _real_stat(path)
    except OSError:
        return
    for number in range(3, 200):
        try:
            own = os.fstat(number)
        except OSError:
            continue
        if (own.st_dev, own.st_ino) == (at.st_dev, at.st_ino):
            raise PermissionError(13, f"{SYSTEM}: the file is being used by another process", str(path))


_real_stat = os.stat
_PATHS = {"open": 1, "os.rename": 2, "os.remove": 1, "os.mkdir": 1, "os.listdir": 1, "os.scandir": 1, "os.symlink": 2}
"""Events of file operations, with the number of paths among their arguments."""


def _audit(event: str, arguments: tuple[object, ...]) -> None:
    if event not in _PATHS or not _calls_midspan():
        return
    for path in arguments[: _PATHS[event]]:
        if _lacks(path):
            raise FileNotFoundError(2, f"no such file on {SYSTEM}", str(path))
        if SYSTEM == "windows":
            _check_name(path)
            if event in {"os.rename", "os.remove"}:
                _check_closed(path)


def _stat(path: Any, *arguments: Any, **options: Any) -> Any:
    if _lacks(path) and _calls_midspan():
        raise FileNotFoundError(2, f"no such file on {SYSTEM}", str(path))
    return _real_stat(path, *arguments, **options)


def _is_socket(file: Any) -> bool:
    number = file if isinstance(file, int) else file.fileno()
    return stat.S_ISSOCK(os.fstat(number).st_mode)


def _windows() -> None:
    """Define the functions and classes that behave differently on Windows."""
    exclusive, new_group = -5, 0x200  # SO_EXCLUSIVEADDRUSE and CREATE_NEW_PROCESS_GROUP

    def kill(pid: int, number: int) -> None:
        # CTRL_C_EVENT is 0, CTRL_BREAK_EVENT 1; on Windows, any other number ends the process and is its exit code
        if number in {0, 1}:
            os.kill(pid, signal.SIGINT)
        else:
            os.kill(pid, signal.SIGKILL)

    def select_(readable: Any, writable: Any, exceptional: Any, timeout: float | None = None) -> Any:
        for file in (*readable, *writable, *exceptional):
            if not _is_socket(file):
                raise OSError(10038, "an operation was attempted on something that is not a socket")
        return select.select(readable, writable, exceptional, timeout)

    class Selector(selectors.SelectSelector):
        def register(self, fileobj: Any, events: int, data: Any = None) -> Any:
            if not _is_socket(fileobj):
                raise OSError(10038, "an operation was attempted on something that is not a socket")
            if len(self.get_map()) >= 512:
                raise ValueError("too many file descriptors in select()")
            return super().register(fileobj, events, data)

    class Socket(socket.socket):
        @property
        def sendmsg(self) -> None:
            raise AttributeError("sendmsg")

        recvmsg = recvmsg_into = sendmsg

        def setsockopt(self, level: int, option: int, value: Any) -> None:
            if option != exclusive:
                super().setsockopt(level, option, value)

        def shutdown(self, how: int) -> None:
            if self.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                raise OSError(10057, "a request to send or receive data was disallowed: the socket is not connected")
            super().shutdown(how)

        def accept(self) -> Any:
            number, address = self._accept()  # type: ignore[attr-defined]
            sock = type(self)(self.family, self.type, self.proto, fileno=number)
            sock.setblocking(socket.getdefaulttimeout() is None)
            return sock, address

    def socketpair(*_: object) -> Any:
        with socket.create_server(("127.0.0.1", 0)) as server:
            first = Socket(socket.AF_INET, socket.SOCK_STREAM)
            first.connect(server.getsockname())
            second, _address = server.accept()
            return first, Socket(fileno=second.detach())

    class Popen(subprocess.Popen):
        def __init__(
            self, *arguments: Any, start_new_session: bool = False, pass_fds: Any = (), preexec_fn: Any = None,  # noqa: ARG002
            creationflags: int = 0, **options: Any,
        ) -> None:  # fmt: skip
            assert not pass_fds, "pass_fds not supported on Windows."
            if preexec_fn is not None:
                raise ValueError("preexec_fn is not supported on Windows platforms")
            super().__init__(*arguments, start_new_session=bool(creationflags & new_group), **options)

        def send_signal(self, number: int) -> None:
            kill(self.pid, number)

        def terminate(self) -> None:
            super().kill()

    def set_handler(number: int, handler: Any) -> Any:
        if number not in {signal.SIGINT, signal.SIGTERM, signal.SIGABRT, signal.SIGFPE, signal.SIGILL, signal.SIGSEGV}:
            raise ValueError("invalid signal value")
        return signal.signal(number, handler)

    def set_wakeup_fd(number: int, **options: Any) -> Any:
        if number >= 0 and not _is_socket(number):
            raise ValueError("not a socket on Windows")
        return signal.set_wakeup_fd(number, **options)

    text: set[int] = set()
    """Open files in text mode: Windows' default, in which a written 0A becomes 0D 0A."""
    binary = 0x8000

    def open_(path: Any, flags: int, *arguments: Any, **options: Any) -> int:
        if Path(path).is_dir():
            raise PermissionError(13, "Permission denied", str(path))
        number = os.open(path, flags & ~binary, *arguments, **options)
        (text.discard if flags & binary else text.add)(number)
        return number

    def fdopen(number: int, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        if "b" in mode and number in text:
            raise ValueError("the file is in text mode: without O_BINARY, a written 0A becomes 0D 0A")
        text.discard(number)
        return os.fdopen(number, mode, *arguments, **options)

    def write(number: int, data: Any) -> int:
        if number not in text:
            return os.write(number, data)
        os.write(number, bytes(data).replace(b"\n", b"\r\n"))
        return len(data)

    def close(number: int) -> None:
        text.discard(number)
        os.close(number)

    _replaced["os"] = {
        "kill": kill, "open": open_, "fdopen": fdopen, "write": write, "close": close, "O_BINARY": binary,
    }  # fmt: skip
    _replaced["select"] = {"select": select_}
    _replaced["selectors"] = {"SelectSelector": Selector, "DefaultSelector": Selector}
    _replaced["socket"] = {"socket": Socket, "socketpair": socketpair, "SO_EXCLUSIVEADDRUSE": exclusive}
    _replaced["subprocess"] = {"Popen": Popen, "CREATE_NEW_PROCESS_GROUP": new_group}
    _replaced["signal"] = {
        "signal": set_handler,
        "set_wakeup_fd": set_wakeup_fd,
        "CTRL_C_EVENT": 0,
        "CTRL_BREAK_EVENT": 1,
    }
    _replaced["sys"] = {"platform": "win32"}


def _msvcrt() -> types.ModuleType:
    """Return the file-locking part of Windows' C library; each open file has its own locks, as with flock(2)."""
    import fcntl

    module = types.ModuleType("msvcrt")

    def locking(number: int, mode: int, _size: int) -> None:
        if mode == 0:
            fcntl.flock(number, fcntl.LOCK_UN)
            return
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PermissionError(13, "Permission denied") from None

    vars(module).update(LK_UNLCK=0, LK_LOCK=1, LK_NBLCK=2, LK_RLCK=3, LK_NBRLCK=4, locking=locking)
    return module


def _macos() -> None:
    """Define the functions and classes that behave differently on macOS."""

    class Socket(socket.socket):
        def shutdown(self, how: int) -> None:
            if self.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                raise OSError(57, "Socket is not connected")
            super().shutdown(how)

        def bind(self, address: Any) -> None:
            if isinstance(address, str) and (len(address.encode()) > 103 or address.startswith("\0")):
                raise OSError("AF_UNIX path too long, or abstract")
            super().bind(address)

        def accept(self) -> Any:
            number, address = self._accept()  # type: ignore[attr-defined]
            sock = type(self)(self.family, self.type, self.proto, fileno=number)
            sock.setblocking(socket.getdefaulttimeout() is None)
            return sock, address

    _replaced["selectors"] = {"DefaultSelector": selectors.PollSelector}
    _replaced["socket"] = {"socket": Socket}
    _replaced["sys"] = {"platform": "darwin"}


if SYSTEM:
    named_encodings()
    (_windows if SYSTEM == "windows" else _macos)()
    restrict()
    without_kernels()
    os.stat = _stat
    sys.addaudithook(_audit)
