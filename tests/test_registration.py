"""Descriptors of workers and modules: what they import, and how a package registers its own."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.daemon.workers import worker_kinds
from bridge.descriptors import ModuleDescriptor, WorkerDescriptor, all_modules, all_workers
from bridge.modules.module import Module
from bridge.registration import imported, registered

DESCRIPTORS: list[WorkerDescriptor | ModuleDescriptor] = [*all_workers(), *all_modules().values()]
LOADED = """
import json, sys
import bridge.config.received
from bridge.doctor.check import Check  # noqa: F401
print(json.dumps(sorted(sys.modules)))
"""
PACKAGE = """
from bridge.descriptors import NODE, ModuleDescriptor, WorkerDescriptor

WORKER = WorkerDescriptor(
    name="hello", factory="hello.code:HelloWorker", section="hello.section:HelloSection", about="Greets.",
    sections=NODE, checks="hello.checks:CHECKS",
)
MODULE = ModuleDescriptor(
    name="greeter", factory="hello.code:Greeter", section="hello.section:GreeterSection", about="Greets on the hub.",
)
"""
SECTION = '''
from bridge.config.sections.section import ModuleSection, Section, setting


class HelloSection(Section):
    """The worker hello."""

    enabled: bool = setting(False, "Whether it runs.")
    words: str = setting("hello", "The greeting.")


class GreeterSection(ModuleSection):
    """The module greeter."""

    topic: str = setting("/greetings", "Topic of the greetings.")
'''
CHECKS = """
from bridge.doctor.check import Check, ok

CHECKS = (Check("hello", "the greeting", lambda context: ok("hello")),)
"""
USE = """
import json, sys
from bridge.config.load import loads
from bridge.daemon.workers import worker_kinds
from bridge.doctor.checks import CHECKS

config = loads("hello: {enabled: true}\\nmodules: {greeter: {enabled: true}}\\n")
other = loads("hello: {enabled: true, words: hi}\\nmodules: {greeter: {enabled: true}}\\n")
kind = worker_kinds({})["hello"]
print(json.dumps({
    "workers": list(worker_kinds({})), "enabled": kind.enabled(config), "hosted": list(config.hosted),
    "reloads": [name for name, kind in worker_kinds({}).items() if kind.config_part(config) != kind.config_part(other)],
    "topic": config.modules.greeter.topic, "check": "hello" in [check.id for check in CHECKS],
    "imported": "hello.code" in sys.modules,
}))
"""


def run(code: str, **environ: str) -> Any:
    command = [sys.executable, "-P", "-c", code]
    done = subprocess.run(
        command, env={**os.environ, **environ}, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("descriptor", DESCRIPTORS, ids=[each.name for each in DESCRIPTORS])
def test_every_name_of_a_descriptor_can_be_imported(descriptor: WorkerDescriptor | ModuleDescriptor) -> None:
    module = descriptor.factory.partition(":")[0]
    assert importlib.util.find_spec(module) is not None
    places = [descriptor.section, descriptor.checks]
    if isinstance(descriptor, WorkerDescriptor):
        places += [descriptor.uses, descriptor.switch]
    else:
        places += [descriptor.cause, descriptor.accepts]
    for place in filter(None, places):
        assert imported(place) is not None


def test_modules_are_registered_under_their_own_names() -> None:
    for name, descriptor in all_modules().items():
        if importlib.util.find_spec(descriptor.factory.partition(":")[0]):
            kind = imported(descriptor.factory)
            assert issubclass(kind, Module)
            assert kind.name == name


def test_the_configuration_of_a_worker_imports_no_feature() -> None:
    places = {place.partition(":")[0] for each in DESCRIPTORS for place in (each.factory, each.section, each.checks)}
    loaded = set(run(LOADED))
    assert "bridge.descriptors" in loaded
    assert not (places - {""}) & loaded
    assert not {name for name in loaded if name.startswith("bridge.config.sections.")} - {
        "bridge.config.sections.section"
    }


def test_a_package_registers_a_worker_and_a_module(tmp_path: Path) -> None:
    folder = tmp_path / "hello"
    folder.mkdir()
    for name, text in {"__init__.py": PACKAGE, "section.py": SECTION, "checks.py": CHECKS}.items():
        (folder / name).write_text(text)
    path = os.pathsep.join(filter(None, [str(tmp_path), str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH")]))
    used = run(USE, PYTHONPATH=path, MIDSPAN_WORKERS="hello:WORKER", MIDSPAN_MODULES="hello:MODULE")
    assert used == {
        "workers": [*worker_kinds({}), "hello"], "enabled": True, "hosted": ["greeter"], "reloads": ["hello"],
        "topic": "/greetings", "check": True, "imported": False,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ("none.such:WORKER", "the worker none.such:WORKER cannot be imported: No module named 'none'"),
        ("bridge.sides:BUILT_IN", "the worker bridge.sides:BUILT_IN is not a bridge.descriptors.WorkerDescriptor"),
        ("bridge.record:WORKER", "the worker bridge.record:WORKER: there is already a worker named record"),
    ],
)
def test_an_unusable_descriptor_is_reported(place: str, reason: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MIDSPAN_WORKERS", f"ros1=a:B,{place}")
    with pytest.raises(RuntimeError, match=f"^{reason}$"):
        registered(WorkerDescriptor, "worker", ["record"])


def test_a_section_without_a_descriptor_is_not_found() -> None:
    with pytest.raises(LookupError, match=r"bridge\.config\.model:Config is not the section of a worker or a module"):
        Config().section(Config)
