"""Runs the demo and the ROS 1 and contract tests on other systems and with other Pythons (`make test-everywhere`).

    python scripts/everywhere.py [PLACE...]

A place is a release (`trixie`, `noble`, `resolute`), as a fresh minimal system in a folder, or a version of Python
(`3.12`) that this machine has, with the system of this machine. Each place gets a copy of this checkout, and runs what
a newcomer runs: `make demo`, then the tests. Without arguments, all places run; a place that this machine cannot create
is reported. Needs root and debootstrap, takes about half an hour for each place, and is not part of CI. The output is
in .cache/everywhere/.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from scripts import dist  # noqa: E402
from tests.setup.image import PATH, pip_settings  # noqa: E402
from tests.support.debian import Root, proxies  # noqa: E402

OUTPUT = ROOT / ".cache" / "everywhere"
RELEASES = {"trixie": "Debian 13", "noble": "Ubuntu 24.04", "resolute": "Ubuntu 26.04"}
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
TESTS = ("tests/adapters/ros1", "tests/contract", "tests/examples", "tests/demo/test_parts.py")
COPY = "/root/midspan"
_SECONDS = 3600

_ENTER = r"""
root=$1 paths=$2
shift 2
mount --make-rprivate /
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
mount -t tmpfs -o mode=1777 tmpfs "$root/dev/shm"
for path in $paths; do
    if [ -d "$path" ]; then mkdir -p "$root$path"; else mkdir -p "$root${path%/*}"; touch "$root$path"; fi
    mount --bind "$path" "$root$path"
done
exec chroot "$root" env -i "$@"
"""
"""Runs a command in a tree, with this machine's network, devices and package index, but its own shared memory."""


_NO_DART = "simulation: the simulator needs dartpy"
DEMO = f"""
if .venv/bin/python -c 'import dartpy'; then exec make demo JSON=demo.json PNG=demo.png; fi
if make demo >demo.txt 2>&1; then echo 'the demo runs without DART'; exit 1; fi
cat demo.txt
grep -q '{_NO_DART}' demo.txt && ! grep -q 'midspan.demo.' demo.txt
"""
"""Runs the demo. If DART is not published for the machine, the demo must give that reason, not advise the extra."""


@dataclass
class Place:
    """Where the steps run; ``enter`` is put before each command, ``copy`` is the checkout's folder on this machine."""

    name: str
    enter: Sequence[str | Path]
    copy: Path
    results: dict[str, str] = field(default_factory=dict)

    def step(self, title: str, command: str) -> bool:
        """Run a shell command in the copy; return whether it succeeded, and log its output."""
        began = time.monotonic()
        log = OUTPUT / f"{self.name}-{title}.log"
        with log.open("wb") as out:
            try:
                code = subprocess.run(
                    [*self.enter, "sh", "-c", command], stdin=subprocess.DEVNULL, stdout=out,
                    stderr=subprocess.STDOUT, timeout=_SECONDS, check=False,
                ).returncode  # fmt: skip
            except subprocess.TimeoutExpired:
                code = -1
        text = log.read_text(encoding="utf-8", errors="replace")
        result = _result(title, code, text)
        self.results[title] = result
        dist.report(f"{self.name}: {title}: {result} ({time.monotonic() - began:.0f} s; {log})")
        return code == 0


def _result(title: str, code: int, text: str) -> str:
    """Return one cell of the table."""
    if code == -1:
        return f"not finished after {_SECONDS} s"
    if title == "tests":
        summary = re.findall(r"^(?:=+ )?(\d+ (?:passed|failed)[^=\n]*?)(?: in .*)?$", text, re.MULTILINE)
        return summary[-1] if summary else f"exit code {code}"
    if title == "demo" and code == 0 and _NO_DART in text:
        return "no simulator, because DART has no wheel; the demo reports that"
    return "passed" if code == 0 else f"exit code {code}: {text.strip().splitlines()[-1][:200] if text.strip() else ''}"


@contextmanager
def system(release: str) -> Iterator[Place]:
    """Create a fresh minimal system, on which only `make` is installed."""
    with tempfile.TemporaryDirectory(prefix="everywhere-") as folder, ExitStack() as stack:
        root = stack.enter_context(Root(Path(folder) / "tree", release))
        copy = root.folder / COPY[1:]
        dist.copy_tracked(["."], copy)
        settings, paths = pip_settings()
        environ = {"HOME": "/root", "PATH": PATH, "LC_ALL": "C.UTF-8", **proxies(), **settings}
        namespaces = ["unshare", "--mount", "--pid", "--fork", "--kill-child=SIGKILL", "sh", "-ec", _ENTER, "sh"]
        variables = [f"{name}={value}" for name, value in environ.items()]
        place = Place(release, [*namespaces, root.folder, " ".join(paths), "-C", COPY, *variables], copy)
        place.step("make", "apt-get -q update && apt-get -q install -y --no-install-recommends make")
        yield place


@contextmanager
def python(version: str) -> Iterator[Place]:
    """Provide this machine's system, with another Python."""
    program = find_python(version)
    if program is None:
        raise LookupError(f"no Python {version} on this machine")
    with tempfile.TemporaryDirectory(prefix="everywhere-") as folder:
        copy = Path(folder) / "midspan"
        dist.copy_tracked(["."], copy)
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("MIDSPAN_", "PYTHON", "ROS_", "VIRTUAL_ENV"))}
        yield Place(f"python-{version}", _with({**kept, "PYTHON": str(program)}, copy), copy)


def _with(environ: Mapping[str, str], copy: Path) -> list[str]:
    return ["env", "-i", "-C", str(copy), *(f"{name}={value}" for name, value in environ.items())]


def find_python(version: str) -> Path | None:
    """Return a Python with venv, from the system, pyenv or uv."""
    homes = [Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"]
    homes.append(Path.home() / ".local" / "share" / "uv" / "python")
    places = [Path(found) for found in [shutil.which(f"python{version}", path="/usr/bin:/usr/local/bin")] if found]
    places += [path for home in homes for path in sorted(home.glob(f"*{version}*/bin/python{version}"))]
    check = "import ensurepip, ssl, venv"
    return next((p for p in places if subprocess.run([p, "-c", check], check=False).returncode == 0), None)


def run(place: Place) -> None:
    """Run all steps in a place; without DART, the demo must name the reason."""
    if not place.step("set-up", "make setup"):
        return
    place.step("demo", DEMO)
    place.step("tests", f".venv/bin/python -m pytest -q -n 2 -m 'not thorough and not long' {' '.join(TESTS)}")


def main() -> int:
    """Run the places, and print a table; return 1 if a step failed."""
    parser = argparse.ArgumentParser(description="Run the demo and the ROS 1 and contract tests on other systems.")
    parser.add_argument("place", nargs="*", default=[*RELEASES, *PYTHONS], help="default: all")
    args = parser.parse_args()
    OUTPUT.mkdir(parents=True, exist_ok=True)
    results: dict[str, dict[str, str]] = {}
    for name in args.place:
        try:
            with (system if name in RELEASES else python)(name) as place:
                run(place)
                results[place.name] = place.results
        except (AssertionError, LookupError, OSError, subprocess.SubprocessError) as err:
            results[name] = {"never run": str(err)[-300:]}
        (OUTPUT / "results.json").write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    for name, steps in results.items():
        line = "; ".join(f"{title} {result}" for title, result in steps.items())
        sys.stdout.write(f"{RELEASES.get(name, name)}: {line}\n")
    return int(any("fail" in result or "exit" in result for steps in results.values() for result in steps.values()))


if __name__ == "__main__":
    sys.exit(main())
