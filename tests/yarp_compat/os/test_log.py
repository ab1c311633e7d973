"""Log messages on the terminal, in YARP's format."""

from __future__ import annotations

import io
import logging
import subprocess
import sys
from collections.abc import Iterator

import pytest

from yarp_compat.os.log import Log, LogHandler, LogType, enabled, line


@pytest.fixture(autouse=True)
def level() -> Iterator[None]:
    before = Log.minimumPrintLevel()
    yield
    Log.setMinimumPrintLevel(before)
    Log.setPrintCallback(Log.defaultPrintCallback())


def test_messages_use_yarps_streams(capsys: pytest.CaptureFixture[str]) -> None:
    Log.setMinimumPrintLevel(Log.DebugType)
    Log().info("speed %.1f of %s", 0.25, "r1")
    Log.debug("50% done")
    Log.trace("not shown")
    Log.warning("careful")
    Log.error("broken")
    out, err = capsys.readouterr()
    assert out == "[INFO] speed 0.2 of r1\n[DEBUG] 50% done\n"
    assert err == "[WARNING] careful\n[ERROR] broken\n"


def test_log_streams_print_as_in_cpp(capsys: pytest.CaptureFixture[str]) -> None:
    Log.setMinimumPrintLevel(Log.DebugType)
    Log().info() << "speed" << 0.25 << 3 << True << 1 / 3 << [1, 2.5]
    stream = Log("f.py", 12, "go").debug()
    stream << "later"
    assert capsys.readouterr().out == "[INFO] speed 0.25 3 true 0.333333 {1, 2.5}\n"
    del stream
    assert capsys.readouterr().out == "[DEBUG] later\n"


def test_a_message_is_printed_with_its_source_location(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    Log.setMinimumPrintLevel(Log.TraceType)
    Log("f.py", 12, "go").info("hello")
    Log("f.py", 12, "go").trace("hello")
    Log("f.py", 12, "go", "left").info("hello")
    assert capsys.readouterr().out == "[INFO] hello\n[TRACE] go: hello\n[INFO] |left| hello\n"
    monkeypatch.setenv("YARP_VERBOSE_OUTPUT", "1")
    Log("f.py", 12, "go", 5.5).info("hello")
    assert capsys.readouterr().out == "[5.500000] [INFO] f.py:12 go hello\n"


def test_fatal_stream_ends_the_program() -> None:
    code = "import yarp_compat as yarp\nyarp.Log().fatal() << 'over' << 2\nprint('not reached')"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert (ended.returncode, ended.stdout, ended.stderr) == (1, "", "[FATAL] over 2\n")


def test_messages_are_also_forwarded(capsys: pytest.CaptureFixture[str]) -> None:
    forwarded: list[tuple[LogType, str, str]] = []
    Log.setForwardCallback(lambda *message: forwarded.append(message))
    Log.setMinimumForwardLevel(Log.WarningType)
    Log.info("hello")
    Log.error("oh")
    Log.setForwardCallback(None)
    Log.setMinimumForwardLevel(Log.defaultMinimumForwardLevel())
    assert forwarded == [(LogType.ErrorType, "oh", "")]


def test_line_is_written_in_one_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise another thread could print into the line."""

    class Pieces(io.StringIO):
        def write(self, text: str) -> int:
            pieces.append(text)
            return len(text)

    pieces: list[str] = []
    monkeypatch.setattr(sys, "stdout", Pieces())
    Log.info("hello")
    assert pieces == ["[INFO] hello\n"]


def test_fatal_ends_the_program(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        Log.fatal("over")
    assert capsys.readouterr().err == "[FATAL] over\n"


def test_print_callback_replaces_printing(capsys: pytest.CaptureFixture[str]) -> None:
    printed: list[tuple[LogType, str, str]] = []
    Log.setPrintCallback(lambda *message: printed.append(message))
    Log.info("hello")
    assert printed == [(LogType.InfoType, "hello", "")]
    assert capsys.readouterr().out == ""


def test_messages_of_the_library_name_their_component(capsys: pytest.CaptureFixture[str]) -> None:
    handler = LogHandler()
    handler.emit(logging.LogRecord("yarp.os.Port", logging.ERROR, "", 0, "port %s failed", ("/a",), None))
    assert capsys.readouterr().err == "[ERROR] |yarp.os.Port| port /a failed\n"


def test_lines_have_level_and_component() -> None:
    assert line(LogType.InfoType, "text", "yarp.os.Port", color=True) == "[\033[01;34mINFO\033[00m] |yarp.os.Port| text"
    assert enabled({"X": "1"}, "X", default=False)
    assert not enabled({"X": "no"}, "X", default=True)
    assert enabled({}, "X", default=True)
