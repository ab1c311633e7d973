"""The distributions that `make dist` builds: complete, without other files, and each module in only one of them."""

from __future__ import annotations

import base64
import hashlib
import importlib.metadata
import json
import os
import re
import signal
import subprocess
import sysconfig
import tarfile
import time
import tomllib
import zipfile
from collections.abc import Sequence
from contextlib import ExitStack
from email import message_from_string
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement

from bridge import kernels
from scripts import dist, processor, reproducible
from tests.peers.yarp.programs import Definitions, Names, YarpProgram
from tests.peers.zenoh.programs import Ros2ddsBridge, Router
from tests.setup.installed import Installed
from tests.setup.machine import ROOT
from tests.support.missing import COMPILER, need
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.rosbags_messages import Messages
from tests.support.wait import until

COMPILED, PURE, COMPAT = "midspan-*-cp311-abi3-manylinux*.whl", "midspan-*-none-any.whl", "yarp_compat-*-none-any.whl"
INNER = ("packaging/debian/", "packaging/yarp_compat/")
"""Folders with files for building packages, which no distribution contains."""

MODULES = (kernels.SHARED, *kernels.C_MODULES, *kernels.KERNELS)


def tracked(*names: str) -> set[str]:
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "--", *names]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    return {name for name in listed.split("\0") if name and (ROOT / name).is_file()}


def test_each_module_is_in_one_distribution(tmp_path: Path) -> None:
    midspan, compat = tmp_path / "midspan", tmp_path / "compat"
    for folder, lay_out in ((midspan, dist.lay_out_midspan), (compat, dist.lay_out_yarp_compat)):
        folder.mkdir()
        lay_out(folder)
    assert not (midspan / "yarp_compat").exists()
    assert (compat / "yarp_compat" / "__init__.py").is_file()
    assert sorted(entry.name for entry in compat.iterdir()) == [
        "LICENSE", "README.md", "VERSION", "pyproject.toml", "yarp_compat",
    ]  # fmt: skip
    metadata = tomllib.loads((midspan / "pyproject.toml").read_text(encoding="utf-8"))
    assert f"yarp-compat=={dist.version()}" in metadata["project"]["dependencies"]
    assert metadata["tool"]["setuptools"]["packages"]["find"]["include"] == ["bridge*", "navigation*", "sim*"]
    assert not list(midspan.rglob("*.so")), "compiled files are left out"


def test_a_replacement_must_match_exactly_once() -> None:
    with pytest.raises(ValueError, match="2 times"):
        dist.replaced("a = 1\na = 1\n", "a = 1", "a = 2")


def test_links_into_the_repository_become_plain_text_on_a_package_index() -> None:
    text = "See [rules](docs/rules.md#x), [zenoh](https://zenoh.io).\n![a picture](docs/a.png)\nEnd"
    assert dist.without_local_links(text) == "See rules, [zenoh](https://zenoh.io).\nEnd"
    readme = dist.without_local_links((ROOT / "README.md").read_text(encoding="utf-8"))
    assert not re.search(r"\]\((?!https://)", readme)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Sequence[Path]:
    """Return all built files."""
    need(COMPILER)
    folder = tmp_path_factory.mktemp("dist")
    return dist.build(folder / "dist", folder / "work")


@pytest.fixture(scope="module")
def compiled(files: Sequence[Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Installed, Installed]:
    """Return two equal environments with the compiled wheel: one to run, and one to uninstall from."""
    folder = tmp_path_factory.mktemp("dist")
    installed = Installed(folder / "big path", [only(files, COMPILED), only(files, COMPAT)])
    return installed, installed.copy(folder / "both")


def only(files: Sequence[Path], pattern: str) -> Path:
    (match,) = (file for file in files if file.match(pattern))
    return match


def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if not name.endswith("/")}


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_wheel_contains_exactly_the_files_of_its_packages(files: Sequence[Path]) -> None:
    share = f"midspan-{dist.version()}.data/data/share/midspan/"
    outside = {f"{share}{name}" for name in tracked("configs", "packaging") if not name.startswith(INNER)}
    outside |= {f"{share}{n}" for n in tracked("examples") if n.count("/") == 1 and not n.endswith(".md")}
    packages = tracked("bridge", "navigation", "sim")
    pure = {name for name in names(only(files, PURE)) if ".dist-info/" not in name}
    assert pure == packages | outside
    compiled = {n for n in names(only(files, COMPILED)) if ".dist-info/" not in n}
    built = {f"{module.replace('.', '/')}.abi3.so" for module in MODULES} | {"bridge/kernels.json"}
    assert compiled == pure | built
    compat = {n for n in names(only(files, COMPAT)) if ".dist-info/" not in n}
    assert compat == tracked("yarp_compat")


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_metadata_lists_requirements_and_extras(files: Sequence[Path]) -> None:
    for file in files:
        if file.suffix == ".whl":
            with zipfile.ZipFile(file) as archive:
                (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
                metadata = message_from_string(archive.read(name).decode())
        else:
            with tarfile.open(file) as archive:
                (member,) = (m for m in archive.getmembers() if m.name.count("/") == 1 and m.name.endswith("/PKG-INFO"))
                stored = archive.extractfile(member)
                assert stored is not None
                metadata = message_from_string(stored.read().decode())
        assert metadata["Version"] == dist.version()
        assert metadata["Description-Content-Type"] == "text/markdown"
        assert metadata["License-Expression"] == "Apache-2.0"
        assert not re.search(r"\]\((?!https://)", str(metadata.get_payload()))
        needed = [text for text in metadata.get_all("Requires-Dist", []) if "extra ==" not in text]
        if file.name.startswith("yarp_compat"):
            assert needed == ["numpy"]
        else:
            assert f"yarp-compat=={dist.version()}" in needed
            assert set(metadata.get_all("Provides-Extra", [])) == {"ros2", "sim", "web", "foxglove", "demo"}
            wanted = set(required(metadata.get_all("Requires-Dist", []), "demo"))
            assert {"dartpy", "ros-jazzy-rclpy", "starlette", "uvicorn", "zenoh-ros2-sdk"} <= wanted


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_second_build_elsewhere_has_the_same_bytes(
    files: Sequence[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second build has another folder, umask and time zone."""
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    before = os.umask(0o077)
    try:
        built = dist.build(tmp_path / "dist", tmp_path / "another folder")
    finally:
        os.umask(before)
    assert [file.name for file in built] == [file.name for file in files]
    assert [file.name for file in built if file.read_bytes() != only(files, file.name).read_bytes()] == []
    with zipfile.ZipFile(only(files, COMPILED)) as archive:
        seconds = reproducible.epoch() // 2 * 2  # zip stores times with a resolution of 2 s
        assert {info.date_time for info in archive.infolist()} == {time.gmtime(seconds)[:6]}
        assert {info.external_attr >> 16 for info in archive.infolist()} <= {0o100644, 0o100755}


def test_all_files_have_the_commits_time_or_a_given_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    commit = subprocess.run(["git", "show", "-s", "--format=%ct"], cwd=ROOT, capture_output=True, check=True, text=True)
    assert reproducible.epoch() == int(commit.stdout)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767225600")
    assert reproducible.epoch() == 1767225600
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(RuntimeError, match="'yesterday'; it must be seconds since 1970"):
        reproducible.epoch()


def bill(wheel: Path) -> dict[str, Any]:
    """Return a wheel's bill of materials."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if ".dist-info/sboms/" in name)
        return json.loads(archive.read(name))


@pytest.mark.long
@pytest.mark.timeout(900)
def test_each_wheel_lists_what_it_contains_besides_its_own_code(files: Sequence[Path]) -> None:
    """PEP 770: Cython's code in compiled kernels, and the message definitions of other packages."""
    packages = {p.name for p in (ROOT / "bridge/interfaces/definitions").iterdir() if p.is_dir()}
    packages |= {p.name for p in (ROOT / "bridge/messages/definitions").glob("ros?/*") if p.is_dir()}
    definitions = sorted(packages - {"midspan_msgs"})
    cython = f"pkg:pypi/cython@{importlib.metadata.version('cython')}"
    for pattern, name, wanted in (
        (COMPAT, "yarp-compat", []),
        (PURE, "midspan", definitions),
        (COMPILED, "midspan", sorted(["cython", *definitions])),
    ):
        document = bill(only(files, pattern))
        described = document["metadata"]["component"]
        assert (document["bomFormat"], document["specVersion"]) == ("CycloneDX", "1.6")
        assert described["purl"] == f"pkg:pypi/{name}@{dist.version()}"
        assert described["licenses"] == [{"expression": "Apache-2.0"}]
        assert sorted({part["name"] for part in document["components"]}) == wanted
        assert (cython in {part["bom-ref"] for part in document["components"]}) == (pattern == COMPILED)
        refs = [part["bom-ref"] for part in document["components"]]
        assert len(refs) == len(set(refs))
        assert [entry["ref"] for entry in document["dependencies"]] == [described["bom-ref"], *refs]


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_record_of_a_wheel_has_the_digest_of_each_file(files: Sequence[Path]) -> None:
    for wheel in (only(files, pattern) for pattern in (COMPILED, PURE, COMPAT)):
        with zipfile.ZipFile(wheel) as archive:
            (record,) = (name for name in archive.namelist() if name.endswith(".dist-info/RECORD"))
            rows = [line.rsplit(",", 2) for line in archive.read(record).decode().splitlines()]
            assert [row[0] for row in rows] == archive.namelist()
            for name, digest, size in rows[:-1]:
                data = archive.read(name)
                encoded = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode().rstrip("=")
                assert (digest, size) == (f"sha256={encoded}", str(len(data)))
            assert rows[-1] == [record, "", ""]


OTHER = next(name for name in processor.MACHINES if name != processor.native())
"""A processor that this machine does not have."""


def test_building_for_another_processor_names_the_missing_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sysconfig, "get_path", lambda _: "/usr/include/python3.11")
    monkeypatch.setenv("PATH", "/nothing")
    with pytest.raises(RuntimeError, match=f"needs the compiler {processor.MACHINES[OTHER]}-linux-gnu-gcc") as error:
        processor.environ(OTHER)
    assert f"dpkg --add-architecture {OTHER}" in str(error.value)
    assert f"apt-get install crossbuild-essential-{OTHER} libpython3-dev:{OTHER}" in str(error.value)
    assert processor.environ(processor.native()) == {}


def test_building_for_another_processor_needs_debians_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sysconfig, "get_path", lambda _: "/opt/python/include/python3.11")
    with pytest.raises(RuntimeError, match="make setup PYTHON=/usr/bin/python3"):
        processor.environ(OTHER)


def required(requirements: Sequence[str], extra: str) -> list[str]:
    """Return the distributions that an extra of midspan adds, including those of extras that it names."""
    names = []
    for requirement in map(Requirement, requirements):
        if requirement.marker is None or "extra" not in str(requirement.marker):
            continue
        linux = {"python_version": "3.11", "sys_platform": "linux", "platform_machine": "x86_64"}
        if requirement.marker.evaluate({**linux, "extra": extra}):
            further = sorted(requirement.extras) if requirement.name == "midspan" else []
            names += [requirement.name, *(name for nested in further for name in required(requirements, nested))]
    return names


WITHOUT = "import sys\n\nsys.modules.update(dict.fromkeys(('dartpy', 'rclpy', 'zenoh_ros2_sdk', 'starlette')))\n"
"""A ``sitecustomize`` module, which Python runs when it starts; it hides packages of the extra ``demo``."""


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_demo_without_its_extra_names_the_extra(compiled: tuple[Installed, Installed], tmp_path: Path) -> None:
    installed, _ = compiled
    (tmp_path / "sitecustomize.py").write_text(WITHOUT, encoding="utf-8")
    environ = {**installed.environ(), "PYTHONPATH": str(tmp_path)}
    for demo in ("rooms", "topics"):
        done = subprocess.run(
            [installed.bin / "midspan", "demo", demo],
            cwd=tmp_path, env=environ, capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        assert done.returncode == 1
        assert "needs more than this machine has" in done.stderr
        assert "pip install 'midspan[demo]'" in done.stderr
        assert "Traceback" not in done.stderr


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("wheel", [COMPILED, PURE])
def test_midspan_runs_from_its_wheel(
    files: Sequence[Path], wheel: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if wheel == COMPILED:
        environment, _ = request.getfixturevalue("compiled")
    else:
        environment = Installed(tmp_path / "big path", [only(files, wheel), only(files, COMPAT)])
    place = "import bridge, sim, yarp_compat; print(bridge.__file__, sim.__file__, yarp_compat.__file__, sep='\\n')"
    assert all(line.startswith(str(environment.folder)) for line in environment.run("python", "-c", place).splitlines())
    assert environment.run("midspan", "--version") == f"midspan {dist.version()}\n"
    assert "topic" in environment.run("midspan", "--help")
    share = environment.folder / "share" / "midspan"
    assert environment.run("midspan", "config", "check", share / "configs" / "default.yaml")
    findings = environment.run("midspan", "doctor", "--only", "kernels", code=0 if wheel == COMPILED else 1)
    assert ("all kernels are compiled" in findings) == (wheel == COMPILED)
    assert ("not compiled" in findings) == (wheel == PURE)
    assert ("--no-binary midspan" in findings) == (wheel == PURE)
    environment.run("midspan", "install", "--root", environment.folder / "root")
    unit = (environment.folder / "root/etc/systemd/system/midspan.service").read_text(encoding="utf-8")
    assert str(environment.bin / "midspan") in unit
    assert_a_message_crosses(environment)


def assert_a_message_crosses(there: Installed) -> None:
    """Bridge a message from a YARP program to zenoh-bridge-ros2dds with the installed daemon."""
    with ExitStack() as stack:
        names = Names()
        stack.callback(names.stop)
        router = Router()
        stack.callback(router.stop)
        program = YarpProgram(names.client, "/program", Definitions(()))
        stack.callback(program.stop)
        bridge = Ros2ddsBridge(router.endpoint, Messages(ros1=False))
        stack.callback(bridge.stop)
        config = {
            "name": "there",
            "state": stack.enter_context(TemporaryDirectory(prefix="midspan-")),  # socket paths must be short
            "hub": {"listen": f"tcp/127.0.0.1:{free_port()}", "shared_memory": False},
            "ros1": {"enabled": False},
            "ros2": {"enabled": False},
            "yarp": {"nameserver": "site", "address": names.endpoint, "poll": 0.1},
            "zenoh": {"router": router.endpoint, "dialects": [{"dialect": "ros2dds"}]},
        }
        file = there.folder / "midspan.yaml"
        file.write_text(yaml.safe_dump(config), encoding="utf-8")
        daemon = stack.enter_context(Process([there.bin / "midspan", "run", "--config", file], there.environ()))
        out, subscription = program.advertise("/word", "std_msgs/String"), bridge.subscribe("/word", "std_msgs/String")

        def crossed() -> bool:
            assert daemon.popen.poll() is None, daemon.output()
            program.publish(out, {"data": "there"})
            return bool(bridge.wait(subscription, 1, 0.2))

        until(crossed, "a message crosses", 60)
        assert bridge.wait(subscription, 1)[0] == {"data": "there"}
        daemon.signal(signal.SIGINT)
        assert daemon.popen.wait(30) == 0, daemon.output()


SCRIPT = """
import sys, yarp
from yarp_compat.naming.server import NameServer

with NameServer(port=int(sys.argv[1])):
    yarp.Network.init()
    yarp.Network.setNameServerContact(yarp.Contact("/root", "tcp", "127.0.0.1", int(sys.argv[1])))
    source, sink = yarp.BufferedPortVector(), yarp.BufferedPortVector()
    assert source.open("/out") and sink.open("/in") and yarp.Network.connect("/out", "/in")
    vector = source.prepare()
    vector.resize(2)
    vector[1] = 2.5
    source.writeStrict()
    print(sink.read(True).toString())
    source.close()
    sink.close()
    yarp.Network.fini()
"""


@pytest.mark.long
@pytest.mark.timeout(900)
def test_yarp_compat_needs_only_numpy(files: Sequence[Path], tmp_path: Path) -> None:
    environment = Installed(tmp_path / "alone", [only(files, COMPAT)], libraries=("numpy",))
    script = environment.folder / "script.py"
    script.write_text(SCRIPT, encoding="utf-8")
    port = free_port()
    (environment.folder / "yarp.conf").write_text(f"127.0.0.1 {port} yarp\n", encoding="utf-8")
    assert "with every name" in environment.run("python", "-m", "yarp_compat", "--check", script)
    assert "2.5" in environment.run("python", "-m", "yarp_compat", script, str(port))
    environment.run("python", "-c", "import bridge", code=1)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_uninstalling_one_distribution_leaves_the_other_complete(
    files: Sequence[Path], compiled: tuple[Installed, Installed]
) -> None:
    assert not names(only(files, COMPILED)) & names(only(files, COMPAT))
    _, environment = compiled
    environment.pip("uninstall", "-q", "-y", "midspan")
    assert environment.run("python", "-c", "from yarp_compat import Bottle; print(Bottle('1 2').size())") == "2\n"
    left = [file.relative_to(environment.folder).parts for file in environment.folder.rglob("*") if file.is_file()]
    assert any("yarp_compat" in parts for parts in left)
    assert not [parts for parts in left if any(p in ("bridge", "sim") or p.startswith("midspan") for p in parts)]
