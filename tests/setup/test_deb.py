"""The Debian package in a fresh system with its own systemd: installed, upgraded, purged; and checked by lintian."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import sys
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from email import message_from_bytes
from pathlib import Path

import pytest
from packaging.utils import canonicalize_name

from scripts import deb, dist, manual, processor, sbom
from tests.peers.ros1.network import ROS1_CORE, ROS1_PYTHON, ros1_environment
from tests.setup.machine import ROOT
from tests.support.debian import Tree
from tests.support.missing import COMPILER, DEBIAN, ROS1, need
from tests.support.process import Process
from tests.support.wait import until

MASTER = "http://localhost:11311"
NEXT = "99.0.0"
"""The version to upgrade to."""

GAP = ROOT / "tests" / "peers" / "hub" / "gap.py"
SECOND = "name: second\nhub: {listen: tcp/127.0.0.1:7448}\nros1: {enabled: false}\nros2: {domain: 9}\n"
"""Configuration of a second daemon on the same machine."""

RELEASES = os.environ.get("MIDSPAN_RELEASES", "bookworm").split(",")
"""The Debian releases to test; each takes some minutes, and CI tests one."""


def test_the_manual_has_every_verb_and_no_accidental_roff_request() -> None:
    page = manual.page(dist.version())
    verbs = re.findall(r"^\.SS midspan (.+)$", page, re.MULTILINE)
    assert {"run", "worker", "topic", "topic echo", "location add"} <= set(verbs)
    requests = {line.split()[0] for line in page.splitlines() if line[:1] in ".'"}
    assert requests <= {".TH", ".SH", ".SS", ".TP", ".PP", ".B", ".I"}
    assert manual.roff(".start -x\\n") == "\\&.start \\-x\\en"


def test_ros1_is_only_suggested() -> None:
    control = (ROOT / "packaging/debian/control").read_text()
    fields = dict(line.split(": ", 1) for line in control.splitlines() if ": " in line and line[0] != " ")
    assert "python3-rospy" in fields["Suggests"]
    assert not [name for name in ("Depends", "Recommends") if "rospy" in fields[name]]


def wheel(folder: Path, name: str, metadata: str) -> Path:
    """Write a wheel that contains only its metadata."""
    file = folder / f"{name}-1.0-py3-none-any.whl"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(f"{name}-1.0.dist-info/METADATA", f"Name: {name}\nVersion: 1.0\n{metadata}\n")
    return file


def test_the_bill_of_materials_next_to_a_package_names_each_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767225600")
    files = [
        wheel(tmp_path, "Some_Library", "License-Expression: MIT"),
        wheel(tmp_path, "another", "Classifier: License :: OSI Approved :: BSD License"),
        wheel(tmp_path, "third", "License: Zlib"),
        wheel(tmp_path, "without", ""),
    ]
    package = tmp_path / "midspan_1.0~deb12_arm64.deb"
    package.write_bytes(b"package")
    written = deb.write_sbom(package, [sbom.with_digest(sbom.of_wheel(file), file) for file in files])
    assert written.name == "midspan_1.0~deb12_arm64.cdx.json"
    document = json.loads(written.read_text(encoding="utf-8"))
    assert document["metadata"]["timestamp"] == "2026-01-01T00:00:00Z"
    assert document["metadata"]["component"]["purl"] == "pkg:deb/midspan@1.0~deb12?arch=arm64"
    assert document["metadata"]["component"]["hashes"] == [
        {"alg": "SHA-256", "content": hashlib.sha256(b"package").hexdigest()}
    ]
    parts = {part["purl"]: part for part in document["components"]}
    assert list(parts) == [f"pkg:pypi/{name}@1.0" for name in ("another", "some-library", "third", "without")]
    assert parts["pkg:pypi/some-library@1.0"]["licenses"] == [{"expression": "MIT"}]
    assert parts["pkg:pypi/another@1.0"]["licenses"] == [{"license": {"name": "BSD License"}}]
    assert parts["pkg:pypi/third@1.0"]["licenses"] == [{"license": {"name": "Zlib"}}]
    assert "licenses" not in parts["pkg:pypi/without@1.0"]
    content = hashlib.sha256(files[3].read_bytes()).hexdigest()
    assert parts["pkg:pypi/without@1.0"]["hashes"] == [{"alg": "SHA-256", "content": content}]


def build(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """Build a package with a library that has only a source distribution; return package and bill of materials."""

    def pip(command: list[str], _folder: Path) -> str:
        to = Path(command[command.index("-w" if "wheel" in command else "-d") + 1])
        to.mkdir(exist_ok=True)
        if "wheel" in command:
            (module := to / "module.py").write_text("VALUE = 1\n")  # setuptools keeps the mode and the time of a file
            with zipfile.ZipFile(to / "built-1.0-py3-none-any.whl", "w") as archive:
                archive.write(module, "module.py")
                archive.writestr("built-1.0.dist-info/METADATA", "Name: built\nVersion: 1.0\n")
                archive.writestr("built-1.0.dist-info/RECORD", "")
        else:
            (to / "built-1.0.tar.gz").touch()
        return ""

    release, root = deb.RELEASES["bookworm"], folder / "root"
    with monkeypatch.context() as patch:
        patch.setattr(dist, "run", pip)
        wheels = deb.download(release, folder / "wheels", "amd64", ["built"])
    for file in deb.CONFFILES:
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).touch()
    for wheel in wheels:
        deb.unpack(wheel, root / "opt/site", root / "opt")
    package = deb.pack(release, root, folder / "packages", compression="none")
    parts = [sbom.with_digest(sbom.of_wheel(wheel), wheel) for wheel in wheels]
    return [package.read_bytes(), deb.write_sbom(package, parts).read_bytes()]


def test_a_package_built_elsewhere_has_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    builds = []
    for umask, zone, name in ((0o022, "UTC", "first"), (0o077, "Asia/Tokyo", "another folder")):
        monkeypatch.setenv("TZ", zone)
        before = os.umask(umask)
        try:
            (tmp_path / name).mkdir()
            builds.append(build(tmp_path / name, monkeypatch))
        finally:
            os.umask(before)
    assert builds[0] == builds[1]


@pytest.mark.parametrize(("number", "arch"), [(62, "amd64"), (183, "arm64")])
def test_a_library_for_another_processor_is_rejected(
    number: int, arch: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The processor is read from the library, as neither its name nor its wheel's name states it."""
    file = tmp_path / "foreign-1.0-py3-none-any.whl"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("foreign-1.0.dist-info/METADATA", "Name: foreign\nVersion: 1.0\n")
        archive.writestr("foreign/libf.so.1", b"\x7fELF" + bytes(14) + number.to_bytes(2, "little"))
        archive.writestr("foreign/script.so", b"INPUT(libf.so.1)")

    def download(_: deb.Release, to: Path, __: str) -> list[Path]:
        to.mkdir()
        return [file]

    monkeypatch.setattr(deb, "_download", download)
    monkeypatch.setattr(deb, "_system_files", lambda _: None)
    deb.stage(deb.RELEASES["bookworm"], (), tmp_path / "right", arch)
    (other,) = set(processor.ELF) - {arch}
    with pytest.raises(RuntimeError, match=rf"built for another processor than {other}: libf\.so\.1$"):
        deb.stage(deb.RELEASES["bookworm"], (), tmp_path / "wrong", other)


def test_a_package_for_another_processor_has_its_libraries_and_wheel(tmp_path: Path) -> None:
    release = deb.RELEASES["bookworm"]
    arm, here = deb.libraries(release, "arm64"), deb.libraries(release, "amd64")
    assert {text for text in here if text.startswith("ros-jazzy-rclpy")}, "ROS 2 has wheels only for x86-64"
    assert not [text for text in arm if text.startswith("ros-")]
    assert set(arm) <= set(here)
    newest = {text.partition("==")[0] for text in deb.libraries(deb.RELEASES["resolute"], "amd64")}
    assert "backports.zstd" in {text.partition("==")[0] for text in here} - newest, "Python 3.14 already contains it"
    version = dist.version()
    for name in (f"midspan-{version}-cp311-abi3-linux_x86_64.whl", f"yarp_compat-{version}-py3-none-any.whl"):
        (tmp_path / name).touch()
    assert len(deb.own_wheels(tmp_path, "amd64")) == 2
    with pytest.raises(RuntimeError, match="run 'make dist ARCH=arm64'"):
        deb.own_wheels(tmp_path, "arm64")


@dataclass
class Place:
    """A system with two versions of the package in root's home, and lintian on a package without libraries."""

    tree: Tree
    release: deb.Release
    lintian: Process
    environ: dict[str, str]

    def install(self, version: str) -> None:
        """Install a version with the documented command, but without recommended packages.

        The fixture only simulates the command with recommended packages.
        """
        package = f"/root/midspan_{version}{self.release.suffix}_amd64.deb"
        self.tree.run("apt-get", "install", "-y", "--no-install-recommends", package, seconds=900)

    def status(self) -> str:
        """Return the daemon's status line."""
        return self.tree.run("systemctl", "show", "--property=StatusText", "--value", "midspan")

    def nodes(self) -> list[str]:
        """Return the master's nodes; none without a master."""
        return self.tree.machine.run("sh", "-c", "rosnode list || true", env=self.environ).split()

    def joined(self) -> bool:
        """Return whether the master lists the bridge's node, and the daemon's status line says that ros1 runs."""
        return "/midspan" in self.nodes() and "ros1 running" in self.status()


OTHERS = re.compile(
    r"__pycache__|^/(var/(log|cache|lib)/(apt|dpkg|journal|systemd|ucf)|etc/(passwd|group|g?shadow)-$|root/)"
)
"""Files of other packages' programs, apt and systemd; and the test's own packages."""


OWN = re.compile(
    r"(bin|lib|share|site-packages|bridge|navigation|sim|yarp_compat|midspan)$|(python3|midspan|yarp_compat)[-.]"
)
"""Folders with Midspan's own files in the private environment."""


def packages(release: deb.Release, folder: Path) -> list[Path]:
    """Build this version's package, a package that differs only in its version, and one without libraries for lintian.

    Lintian takes a minute and a half for the libraries, whose wheels Midspan does not change.
    """
    for name, lay_out in (("yarp_compat", dist.lay_out_yarp_compat), ("midspan", dist.lay_out_midspan)):
        source = folder / name / "source"
        source.mkdir(parents=True)
        lay_out(source)
        dist.build_wheel(dist.build_sdist(source, folder / name), folder / name / "wheel", folder / name / "build", {})
    wheels = [*folder.glob("*/wheel/*.whl")]
    root = folder / "root"
    components = deb.stage(release, wheels, root)
    first = deb.pack(release, root, folder / "packages", compression="none")
    listed = json.loads(deb.write_sbom(first, components).read_text(encoding="utf-8"))["components"]
    # packages that setuptools vendors are left out
    files = root.glob("opt/midspan/lib/*/site-packages/*.dist-info/METADATA")
    metadata = [message_from_bytes(file.read_bytes()) for file in files]
    contained = sorted(f"{canonicalize_name(message['Name'])} {message['Version']}" for message in metadata)
    assert sorted(f"{part['name']} {part['version']}" for part in listed) == contained
    (module,) = root.glob("opt/midspan/lib/*/site-packages/bridge/__init__.py")
    module.write_text(dist.VERSION_LINE.sub(f'__version__ = "{NEXT}"', module.read_text()))
    second = deb.pack(release, root, folder / "packages", NEXT, compression="none")
    for pattern in ("*", "lib/*", "share/*", "lib/*/site-packages/*"):
        for path in root.glob(f"opt/midspan/{pattern}"):
            if OWN.match(path.name):
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            elif pattern.startswith("lib/"):  # ROS 2's libraries
                path.unlink()
    return [
        first,
        second,
        deb.pack(release, root, folder / "own", compression="gzip"),
    ]  # lintian rejects an uncompressed package


@pytest.fixture(scope="module", params=RELEASES)
def place(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    """A booted system with the packages and their dependencies downloaded but not installed, and a running roscore."""
    for reason in (DEBIAN, COMPILER, ROS1):
        need(reason)
    release, folder = deb.RELEASES[request.param], tmp_path_factory.mktemp("deb")
    environ = {**ros1_environment(MASTER), "ROS_HOME": str(folder / "ros"), "ROS_LOG_DIR": str(folder / "ros" / "log")}
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor())
        packages_ = pool.submit(packages, release, folder)
        tree = stack.enter_context(Tree(folder / "tree", request.param))
        *both, own = packages_.result()
        lintian = stack.enter_context(Process(["lintian", "--allow-root", "--fail-on", "error", own]))
        for package in both:
            shutil.copy(package, tree.folder / "root" / package.name)
        documented = ["apt-get", "install", "-y", f"/root/{both[0].name}"]
        planned = tree.chroot(*documented, "--simulate")
        assert {"midspan", "g++", "python3-dev"} <= set(re.findall(r"^Inst (\S+)", planned, re.MULTILINE))
        tree.chroot(*documented, "--no-install-recommends", "--download-only")
        # netbase would create this file, but rospy no longer depends on it
        (tree.folder / "etc/hosts").write_text("127.0.0.1 localhost\n")
        tree.boot()
        stack.enter_context(tree.machine.start(ROS1_PYTHON, ROS1_CORE, "11311", env=environ))
        made_place = Place(tree, release, lintian, environ)
        until(lambda: "/rosout" in made_place.nodes(), "the master is running")
        yield made_place


@pytest.mark.long
@pytest.mark.timeout(2400)
def test_a_package_is_installed_runs_is_upgraded_and_purged(place: Place, tmp_path: Path) -> None:
    """This is one test because each step depends on the previous one."""
    tree = place.tree
    place.install(dist.version())
    assert tree.run("systemctl", "is-active", "midspan", "midspan-router").split() == ["active", "active"]
    until(place.joined, "the bridge has joined the master", 60)
    assert tree.run("midspan", "--version") == f"midspan {dist.version()}\n"
    assert tree.run("stat", "--format=%U", "/var/lib/midspan") == "midspan\n"
    for file in ("man/man1/midspan.1.gz", "bash-completion/completions/midspan", "zsh/vendor-completions/_midspan"):
        assert (tree.folder / "usr/share" / file).stat().st_size > 1000

    installed = tree.files()
    config = tree.folder / "etc/midspan/midspan.yaml"
    config.write_text(config.read_text() + "\nstore: {enabled: true} # ours\n")
    tree.run("systemctl", "reload", "midspan")
    until(lambda: add_kitchen(place), "the store accepts a location", 60)

    second = ("midspan-router@second", "midspan@second")
    (tree.folder / "etc/midspan/second.yaml").write_text(SECOND)
    tree.run("systemctl", "enable", "--now", *second)
    assert tree.run("systemctl", "is-active", *second).split() == ["active", "active"]
    until(lambda: "ros2 running" in status_of(place, "midspan@second"), "the second daemon runs", 60)
    before = [tree.run("systemctl", "show", "-P", "MainPID", unit) for unit in second]

    gap = Process(tree.machine.command(sys.executable, GAP, "tcp/127.0.0.1:7447"), pipes=True)
    with gap:
        longest(gap)
        place.install(NEXT)
        until(place.joined, "the bridge has joined the master again", 60)
        cut = longest(gap)
        print(f"the upgrade cut two clients of the router for {cut:.2f} s")
        assert cut < 3
    assert tree.run("dpkg-query", "-W", "-f", "${Version}", "midspan") == f"{NEXT}{place.release.suffix}"
    assert "# ours" in config.read_text()
    assert "kitchen" in tree.run("midspan", "location", "list")
    assert tree.run("systemctl", "is-active", *second).split() == ["active", "active"]
    after = [tree.run("systemctl", "show", "-P", "MainPID", unit) for unit in second]
    assert not set(before) & set(after), "both processes run the new version"
    until(lambda: "ros2 running" in status_of(place, "midspan@second"), "the second daemon runs again", 60)
    services = tree.run("midspan", "doctor", "--only", "services")
    assert "midspan@second is the daemon second (/etc/midspan/second.yaml)" in " ".join(services.split())

    tree.run("apt-get", "purge", "-y", "midspan", seconds=300)
    assert left_behind(tree, installed) == []
    named = tree.run(
        "sh", "-c", "getent passwd midspan; getent group midspan; systemctl list-unit-files; systemctl --failed"
    )
    assert "midspan" not in named
    tree.run("pgrep", "-f", "midspan", code=1)


def status_of(place: Place, unit: str) -> str:
    """Return the status line of a unit."""
    return place.tree.run("systemctl", "show", "--property=StatusText", "--value", unit)


def add_kitchen(place: Place) -> bool:
    """Store a location by the package's command line; return whether it succeeded."""
    try:
        place.tree.run("midspan", "location", "add", "kitchen", "2.5", "1", "90", "--map", "house")
    except AssertionError:
        return False
    return "kitchen" in place.tree.run("midspan", "location", "list")


def longest(gap: Process) -> float:
    """Return the longest time in seconds between two messages since the last call."""
    assert gap.popen.stdin is not None
    assert gap.popen.stdout is not None
    gap.popen.stdin.write("\n")
    gap.popen.stdin.flush()
    return float(gap.popen.stdout.readline())


def left_behind(tree: Tree, installed: set[str]) -> list[str]:
    """Return files that are named after Midspan, were created after its installation, or have no owner any longer."""
    files = tree.files()
    left = {path for path in files if "midspan" in path and not OTHERS.search(path)}
    left |= {path for path in files - installed if not OTHERS.search(path)}
    left |= set(tree.run("find", "/", "/dev/shm", "-xdev", "-nouser").split())
    return sorted(left)


@pytest.mark.long
@pytest.mark.timeout(2400)
def test_lintian_reports_no_error(place: Place) -> None:
    code = place.lintian.popen.wait(1200)
    output = place.lintian.output()
    assert code == 0, output[-4000:]
    assert not re.search(r"^E: ", output, re.MULTILINE)
