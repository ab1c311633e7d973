"""A forked program is like a started one, with its own environment, session, output and exit code."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from tests.peers.daemon.midspan import MidspanDaemon
from tests.peers.daemon.routers import end_router
from tests.support import forked_workers, forks
from tests.support.process import Process
from tests.support.wait import until

ROOT = Path(__file__).parents[1]
Start = Callable[..., Process]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """A function that forks programs of a few lines."""
    numbers = itertools.count()
    with contextlib.ExitStack() as stack:

        def started(
            text: str, *args: str, pipes: bool = False, imports: tuple[str, ...] = ("json",), **env: str
        ) -> Process:
            file = tmp_path / f"program_{next(numbers)}.py"
            file.write_text(text)
            process = Process([sys.executable, file, *args], {**os.environ, **env}, pipes=pipes, imports=imports)
            return stack.enter_context(process)

        yield started


def test_a_forked_program_has_its_arguments_exit_code_and_output(start: Start) -> None:
    program = start("import sys; print(*sys.argv[1:]); print('bad', file=sys.stderr); sys.exit(7)", "one", "two")
    assert program.popen.wait(20) == 7
    assert set(program.output().splitlines()) == {"one two", "bad"}


def test_threads_and_exit_handlers_end_before_a_program(start: Start) -> None:
    program = start(
        "import atexit, sys, threading, time\natexit.register(print, 'handler')\nended = threading.Event()\n"
        "threading.Thread(target=lambda: (ended.wait(), time.sleep(0.1), print('thread'))).start()\n"
        "print('main')\nended.set()\nsys.exit(3)"
    )
    assert program.popen.wait(20) == 3
    assert program.output().splitlines() == ["main", "thread", "handler"]


def test_a_program_can_exit_with_a_text(start: Start) -> None:
    program = start("import sys; sys.exit('no robot')")
    assert program.popen.wait(20) == 1
    assert program.output() == "no robot\n"


def test_exceptions_are_reported(start: Start) -> None:
    program = start("import no_such_module_anywhere")
    assert program.popen.wait(20) == 1
    assert "No module named 'no_such_module_anywhere'" in program.output()


def test_the_exit_code_of_a_killed_program_is_its_signal(start: Start) -> None:
    program = start("import time\nprint('on', flush=True)\ntime.sleep(60)")
    until(program.output, "the program runs")
    assert program.popen.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        program.popen.wait(0.01)
    program.signal(signal.SIGTERM)
    assert program.popen.wait(20) == -signal.SIGTERM
    assert program.popen.poll() == -signal.SIGTERM


def test_a_piped_program_answers_lines_and_reads_the_end_of_its_input(start: Start) -> None:
    program = start(
        "import sys\nfor line in sys.stdin: print(line.strip()[::-1], flush=True)\nprint('end')", pipes=True
    )
    other = start("import sys\nsys.stdin.read()", pipes=True)  # inherits nothing from the first program
    assert program.popen.stdin is not None
    assert program.popen.stdout is not None
    program.popen.stdin.write("abc\n")
    program.popen.stdin.flush()
    assert program.popen.stdout.readline() == "cba\n"
    program.popen.stdin.close()
    assert program.popen.stdout.read() == "end\n"
    assert program.popen.wait(20) == 0
    assert other.popen.poll() is None


def test_each_program_has_its_own_environment_session_and_modules(start: Start) -> None:
    text = "import os, sys, json; print(os.environ.get('ONE'), os.getsid(0) == os.getpid(), hasattr(json, 'mark'))"
    first, second = start(text + "\njson.mark = 1", ONE="1"), start(text)
    assert (first.popen.wait(20), second.popen.wait(20)) == (0, 0)
    assert (first.output(), second.output()) == ("1 True False\n", "None True False\n")


def test_a_variable_that_is_not_passed_is_unset(tmp_path: Path) -> None:
    file = tmp_path / "program.py"
    file.write_text("import os; print(sorted({'HOME', 'LANG_OF_A_TEST'} & set(os.environ)))")
    env = {**os.environ, "LANG_OF_A_TEST": "x"}
    env.pop("HOME", None)
    with Process([sys.executable, file], env, imports=("json",)) as program:
        assert program.popen.wait(20) == 0
        assert program.output() == "['LANG_OF_A_TEST']\n"


def test_pythons_own_variables_are_applied(start: Start) -> None:
    program = start("import sys; print(sys.flags.optimize)", PYTHONOPTIMIZE="1")
    assert program.popen.wait(20) == 0
    assert program.output() == "1\n"


def test_modules_are_run_by_their_name() -> None:
    with Process([sys.executable, "-m", "json.tool"], pipes=True, imports=("json",)) as program:
        assert program.popen.stdin is not None
        assert program.popen.stdout is not None
        program.popen.stdin.write("[1]")
        program.popen.stdin.close()
        assert program.popen.stdout.read() == "[\n    1\n]\n"
        assert program.popen.wait(20) == 0


def test_dependencies_of_the_tests_are_imported_before_the_fork_but_the_tests_are_not(start: Start) -> None:
    program = start(
        f"import sys\nready = set(sys.modules)\nsys.path.insert(0, {str(ROOT)!r})\n"
        "from tests.support.rosbags_messages import Messages\n"
        "print('rosbags' in ready, 'tests' in ready, Messages.__name__)",
        PYTHONHASHSEED="11",
    )
    assert program.popen.wait(20) == 0, program.output()
    assert program.output() == "True False Messages\n"


def test_programs_that_start_threads_on_import_are_not_forked(start: Start, tmp_path: Path) -> None:
    (tmp_path / "starts_threads.py").write_text(
        "import threading\nthreading.Thread(target=threading.Event().wait, daemon=True).start()"
    )
    with pytest.raises(AssertionError, match="starts threads"):
        start("", imports=("starts_threads",), PYTHONPATH=str(tmp_path))


def test_programs_end_with_the_process_that_forked_them(start: Start) -> None:
    program = start("import time\ntime.sleep(60)", PYTHONHASHSEED="7")
    process = psutil.Process(program.pid)
    server = process.parent()
    assert server is not None
    server.kill()
    assert program.popen.wait(20) == -signal.SIGKILL
    until(lambda: not process.is_running() or process.status() == psutil.STATUS_ZOMBIE, "the process has ended")
    assert start("print('again')", PYTHONHASHSEED="7").popen.wait(20) == 0


def test_only_programs_of_the_tests_are_forked_by_default() -> None:
    assert forks.can_fork([sys.executable, str(Path(__file__).parent / "peers" / "ros2" / "peer.py")])
    assert not forks.can_fork([sys.executable, "-c", "pass"])
    assert not forks.can_fork(["/usr/bin/python3", "/usr/bin/roscore"])


def test_a_forked_program_shows_its_command(start: Start) -> None:
    program = start("import time\nprint('on', flush=True)\ntime.sleep(60)", "first", "second")
    until(program.output, "the program runs")
    assert [word for word in psutil.Process(program.pid).cmdline() if word] == program.args


def sockets(pid: int) -> set[str]:
    """Return the sockets of a running process, which may close some of its files meanwhile."""
    held = set()
    for file in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):
            held.add(file.readlink().name)
    return {name for name in held if name.startswith("socket:")}


def test_a_forked_daemon_forks_its_workers(tmp_path: Path) -> None:
    daemon = MidspanDaemon(tmp_path, "forks")
    daemon.configure(**{side: {"enabled": False} for side in ("ros1", "ros2", "yarp", "zenoh")})
    daemon.run()
    process = daemon.daemon
    assert process is not None
    with process:
        until(lambda: "ready: router running" in process.output(), "the router runs")
        (router,) = psutil.Process(process.pid).children()
        assert os.getsid(router.pid) == router.pid
        words = router.cmdline()
        assert words[1:8] == ["-P", "-m", "bridge.cli.child", "worker", "router", "--supervised", "--control"]
        assert words[-1] == "", "the rest of the fork server's own command is overwritten"
        assert not sockets(process.pid) & sockets(router.pid), "the worker has no socket of the daemon"
        router.kill()
        until(lambda: "router killed by SIGKILL" in process.output(), "the daemon reports the router's end")
    end_router(tmp_path / "state")


@pytest.mark.parametrize(
    ("changes", "forked"),
    [
        ({}, True),
        ({"ROS_MASTER_URI": "http://localhost:1"}, True),
        ({"LD_LIBRARY_PATH": "/one"}, True),
        ({"LD_LIBRARY_PATH": "/one:/three"}, False),
        ({"PYTHONHASHSEED": "1"}, False),
        ({"MIDSPAN_CACHE": "/cache"}, False),
    ],
)
def test_a_worker_with_another_environment_at_its_start_is_started(
    changes: dict[str, str], forked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LD_LIBRARY_PATH", "/one:/two")
    command = [sys.executable, "-P", "-m", "bridge.cli.child", "worker", "ros1", "--supervised"]
    assert forked_workers.can_fork(command, {**os.environ, **changes}) is forked
    assert not forked_workers.can_fork(["midspan"], os.environ)
