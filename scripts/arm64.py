"""Runs Midspan's arm64 wheel under qemu, in minimal systems of Debian 12 and 13 (`make test-arm64`).

    python scripts/arm64.py [RELEASE...]

Each release gets a system in .cache/arm64/, with the wheel that `make dist ARCH=arm64` built and its libraries in a
virtual environment. There the script runs the kernels' tests, and the kernels with fixed inputs, whose results must
equal the results on this machine. `midspan run` bridges a topic between each pair of YARP, zenoh and ROS 1, and
RobotPathPlanner, RobotGoto and the localizer drive to goals in lock-step with the simulator. ROS 2 is not tested,
because it has no wheels for arm64.
Needs root, debootstrap and qemu; is not part of CI. The output is in .cache/arm64/.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from bridge import kernels  # noqa: E402
from scripts import deb, dist  # noqa: E402
from tests.arm64.results import differences  # noqa: E402
from tests.support import foreign  # noqa: E402

OUTPUT = ROOT / ".cache" / "arm64"
TITLES = {"bookworm": "Debian 12", "trixie": "Debian 13"}
PACKAGES = ("libgl1", "python3", "python3-venv")  # the simulator loads libGL
EXTRAS = ("sim", "web")
TOOLS = ("hypothesis", "pytest", "pytest-randomly", "pytest-timeout", "pytest-xdist", "setuptools")
KERNEL_TESTS = (
    "tests/bags/test_split.py", "tests/messages/transcode/test_vm.py", "tests/navigation/algorithms",
    "tests/navigation/maps/test_maps.py", "tests/sim/test_depth_kernel.py", "tests/sim/test_laser.py",
    "tests/sim/test_laser_kernel.py", "tests/tf/test_buffer.py", "tests/tf/test_kernels.py",
)  # fmt: skip
"""The tests of all kernels in `bridge.kernels`; tests/arm64/test_program.py checks that none is missing."""

RESULTS = [sys.executable, "-m", "tests.arm64.results"]
_HERE = OUTPUT / "results-here.json"
_PACKAGES = ("bridge", "navigation", "sim", "yarp_compat")
"""The packages in the wheel; the copy of this checkout lacks them, so that tests import the installed packages."""

_COPY, _VENV, _WHEELS = "root/midspan", "opt/midspan", "root/wheels"
_SECONDS = 3600
_SLOWNESS = "10"
"""Factor for the deadlines of tests: qemu needs several times the processor time, and the machine may be busy."""


class Place:
    """One release's system; each step adds a line to the table."""

    def __init__(self, name: str) -> None:
        self.name, self.table = name, dict[str, str]()
        self.tree = foreign.ForeignTree(OUTPUT / name, name, PACKAGES)
        self.copy = self.tree.folder / _COPY

    def step(self, title: str, work: Callable[[Path], str]) -> bool:
        """Run a step, which returns its result or raises `RuntimeError`; return whether it passed."""
        log = OUTPUT / f"{self.name}-{title.replace(' ', '-')}.log"
        log.unlink(missing_ok=True)
        began = time.monotonic()
        dist.report(f"{self.name}: {title} ...")
        try:
            result, passed = work(log), True
        except RuntimeError as err:
            result, passed = f"FAILED: {err}", False
        self.table[title] = f"{result} ({time.monotonic() - began:.0f} s)"
        dist.report(f"{self.name}: {title}: {self.table[title]}")
        return passed

    def run(self, log: Path, words: Sequence[str], **environ: str) -> str:
        """Run a program of the environment in the copy; return the last line of its output."""
        command = ["env", f"--chdir=/{_COPY}", f"/{_VENV}/bin/{words[0]}", *words[1:]]
        code = self.tree.run(command, log, _SECONDS, environ)
        lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines() or [""]
        if code:
            raise RuntimeError(f"{lines[-1]}; exit code {code}, {log}")
        return lines[-1].strip("= ")

    def test(self, log: Path, files: Sequence[str], workers: int = 0, **environ: str) -> str:
        """Run tests; those that need ROS or a compiler are skipped."""
        options = ["-q", "-n", str(workers), "-p", "no:cacheprovider", "-p", "no:randomly", "--timeout", str(_SECONDS)]
        options += ["-m", "not thorough and not long", *files]
        return self.run(log, ["python", "-m", "pytest", *options], MIDSPAN_TEST_SLOWNESS=_SLOWNESS, **environ)


def stale(wheel: Path) -> list[str]:
    """Return the kernels in a wheel that were compiled from other sources than this checkout's."""
    with zipfile.ZipFile(wheel) as archive:
        record = json.loads(archive.read(f"bridge/{kernels.RECORD}"))
    return [name for name in kernels.KERNELS if record.get(name) != kernels.digest(name, record.get("cython", ""))]


def wheels(folder: Path) -> list[Path]:
    """Return Midspan's wheel and yarp-compat's; they are built if they are missing or stale."""
    try:
        own = deb.own_wheels(folder, "arm64")
        reason = ", ".join(stale(own[0]))
    except RuntimeError:
        reason = "they are missing"
    if reason:
        dist.report(f"building the wheels for arm64 ({reason})")
        work = ROOT / "build" / "arm64"
        shutil.rmtree(work, ignore_errors=True)
        dist.build(folder, work, "arm64")
        shutil.rmtree(work)
        own = deb.own_wheels(folder, "arm64")
    return own


def install(place: Place, own: Sequence[Path], log: Path) -> str:
    """Install the wheels and the test tools, unless the environment has the same ones; copy the tests."""
    root = place.tree.folder
    names = [".", *(f":(exclude){name}" for name in _PACKAGES)]
    shutil.rmtree(place.copy, ignore_errors=True)
    dist.copy_tracked(names, place.copy)
    release = deb.RELEASES[place.name]
    wanted = deb.libraries(release, "arm64", EXTRAS, TOOLS)
    contents = "".join(hashlib.sha256(wheel.read_bytes()).hexdigest() for wheel in own)
    key, record = f"{wanted} {contents}", root / _VENV / "installed"
    if record.exists() and record.read_text(encoding="utf-8") == key:
        return "installed before"
    for folder in (_VENV, _WHEELS):
        shutil.rmtree(root / folder, ignore_errors=True)
    deb.download(release, root / _WHEELS, "arm64", wanted)
    for wheel in own:
        shutil.copy(wheel, root / _WHEELS)
    # unpacked without pip, which takes minutes under qemu; Midspan's programs are not needed
    if place.tree.run(["python3", "-m", "venv", "--without-pip", f"/{_VENV}"], log, _SECONDS):
        raise RuntimeError(f"no virtual environment; {log}")
    site = root / _VENV / "lib" / f"python3.{release.python}" / "site-packages"
    files = sorted((root / _WHEELS).glob("*.whl"))
    for wheel in files:
        deb.unpack(wheel, site, root / _VENV)
    version = place.run(log, ["python", "-m", "bridge.cli.main", "--version"])
    record.write_text(key, encoding="utf-8")
    return f"{version}, {len(files)} wheels"


def results_here() -> None:
    """Compute the kernels' results on this machine, for `compare`; raises `RuntimeError`."""
    done = subprocess.run([*RESULTS, str(_HERE)], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"the kernels fail on this machine: {done.stderr[-300:]}")


def compare(place: Place, log: Path) -> str:
    """Compare the kernels' results in a release with those of this machine."""
    place.run(log, ["python", "-m", "tests.arm64.results", "results.json"])
    ours, theirs = (json.loads(file.read_text(encoding="utf-8")) for file in (_HERE, place.copy / "results.json"))
    different = differences(ours, theirs)
    log.write_text("\n".join(different) + "\n", encoding="utf-8")
    if different:
        raise RuntimeError(f"{len(different)} of {len(ours)} results differ; {different[0]}; {log}")
    return f"{len(ours)} of {len(ours)} results are equal"


def run(place: Place, own: Sequence[Path]) -> bool:
    """Run all steps in a release; return whether all passed."""
    if not place.step("system", lambda log: "created" if place.tree.create(log) else "created before"):
        return False
    if not place.step("wheels", lambda log: install(place, own, log)):
        return False
    passed = [
        place.step("results", lambda log: compare(place, log)),
        place.step("goto", lambda log: place.test(log, ["tests/navigation/closed_loop/test_goals.py"])),
        place.step(
            "daemon", lambda log: place.test(log, ["tests/daemon/test_other_os.py"], MIDSPAN_TEST_SYSTEMS="here")
        ),
        place.step("kernels", lambda log: place.test(log, KERNEL_TESTS, workers=2)),
    ]
    return all(passed)


def main() -> int:
    """Run the releases, and print a table; return 1 if a step failed."""
    parser = argparse.ArgumentParser(description="Test Midspan on arm64 under qemu.")
    parser.add_argument("release", nargs="*", default=[*TITLES], help="default: bookworm and trixie")
    parser.add_argument("--folder", type=Path, default=ROOT / "dist", help="folder of the wheels; default: dist/")
    args = parser.parse_args()
    unknown = [name for name in args.release if name not in TITLES]
    if unknown:
        parser.error(f"unknown release {unknown[0]}; known: {', '.join(TITLES)}")
    lacks = foreign.missing()
    if lacks:
        sys.exit(f"arm64: this machine lacks {', '.join(lacks)}")
    OUTPUT.mkdir(parents=True, exist_ok=True)
    try:
        own = wheels(args.folder.absolute())
        results_here()
    except RuntimeError as err:
        sys.exit(f"arm64: {err}")
    places = [Place(name) for name in args.release]
    with ThreadPoolExecutor(len(places)) as pool:  # most steps of a release use one core
        passed = list(pool.map(lambda place: run(place, own), places))
    for place in places:
        sys.stdout.write(f"{TITLES[place.name]} on arm64\n")
        sys.stdout.writelines(f"  {title:<8} {result}\n" for title, result in place.table.items())
    return int(not all(passed))


if __name__ == "__main__":
    sys.exit(main())
