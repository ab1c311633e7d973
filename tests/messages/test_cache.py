"""Where compiled code is kept."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest

from bridge.messages.cache import cache_folder, compiled

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture
def sources(tmp_path: Path) -> list[Path]:
    folder = tmp_path / "package"
    folder.mkdir()
    for name in ("one.py", "two.py"):
        (folder / name).write_text(name)
    return [folder / "one.py", folder / "two.py"]


@pytest.fixture(autouse=True)
def _bare_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("NUMBA_CACHE_DIR", "CACHE_DIRECTORY", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))


def test_beside_the_sources(sources: list[Path]):
    folder = cache_folder(sources)
    assert folder is not None
    assert folder.parent == sources[0].parent / "__pycache__"


def test_a_change_in_any_source_is_another_folder(sources: list[Path]):
    before = cache_folder(sources)
    sources[1].write_text("changed")
    assert cache_folder(sources) != before


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "CACHE_DIRECTORY", "XDG_CACHE_HOME", "HOME"])
def test_where_the_package_cannot_be_written(
    sources: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str
):
    # A file in the folder's place: root may write anywhere.
    (sources[0].parent / "__pycache__").write_text("")
    monkeypatch.setenv(variable, str(tmp_path / "given"))
    folder = cache_folder(sources)
    assert folder is not None
    assert tmp_path / "given" in folder.parents


def test_a_folder_that_others_can_write_is_not_used(
    sources: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    first = cache_folder(sources)
    assert first is not None
    first.chmod(0o777)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "given"))
    folder = cache_folder(sources)
    assert folder is not None
    assert tmp_path / "given" in folder.parents


def test_threads_that_compile_at_once_keep_to_their_own_folders(sources: list[Path]):
    """Numba has one folder for the whole process, and modules compile on threads of their own."""
    before, inside, seen = numba.config.CACHE_DIR, threading.Semaphore(0), dict[str, set[str]]()

    def compiling(_signature: None, *, cache: bool) -> Callable[[Any], Any]:
        assert cache
        inside.release()

        def make(function: Callable[[], None]) -> Callable[[], None]:
            name = threading.current_thread().name
            found = seen.setdefault(name, set())
            found.add(numba.config.CACHE_DIR)
            inside.acquire()
            inside.acquire(timeout=0.2)  # another one that gets here at the same time
            found.add(numba.config.CACHE_DIR)
            return function

        return make

    def run(source: Path) -> None:
        compiled(lambda: None, None, [source], compiling)

    threads = [threading.Thread(target=run, args=(source,), name=source.name) for source in sources]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    assert seen == {source.name: {str(cache_folder([source]))} for source in sources}
    assert before == numba.config.CACHE_DIR


def test_converters_are_loaded_from_it(tmp_path: Path):
    """A second process compiles nothing: its files are as they were."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    code = (
        "from bridge.messages.registry import Registry; "
        "from bridge.messages import machine; "
        "assert Registry().ros1_to_hub('std_msgs/Bool').convert(b'\\1') == b'\\0\\1\\0\\0\\1'; "
        "print(sum(machine._compiled.stats.cache_hits.values()))"
    )
    hits = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=REPOSITORY, env=env, capture_output=True, text=True, check=True
        )
        hits.append(int(done.stdout))
    assert hits == [0, 1]
    assert list(tmp_path.rglob("*.nbc"))
