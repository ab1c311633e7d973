"""Two hundred thousand inputs for all parsers, and tests of the fuzzing engine."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz import watch
from tests.fuzz.__main__ import MARK, report, shares
from tests.fuzz.run import Finding
from tests.fuzz.target import Subject, Target
from tests.fuzz.targets import TARGETS

ROOT = Path(__file__).parents[2]
INPUTS = 200_000
BUDGET = 5.0
"""Maximum processor time per target, seconds; all targets together need 25 s on an idle machine."""


@pytest.mark.long
@pytest.mark.timeout(600)
def test_all_parsers_survive_many_inputs(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    command = [sys.executable, "-m", "tests.fuzz", "--inputs", str(INPUTS), "--seconds", str(BUDGET)]
    command += ["--json", str(figures), "--save", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    print(done.stdout)
    findings = done.stdout[
        done.stdout.find(f"\n{MARK}") :
    ]  # the findings are at the end of the output, after the table
    assert done.returncode == 0, findings + done.stderr[-3000:]
    results = json.loads(figures.read_text())
    assert set(results) == set(TARGETS)
    for target, inputs in shares(list(TARGETS.values()), INPUTS).items():
        figure = results[target.name]
        assert figure["inputs"] >= inputs or figure["seconds"] > 0.9 * BUDGET


def test_a_target_stops_after_its_time() -> None:
    inputs = engine(
        "done = run.fuzz(Subject(len, [b'n'], (ValueError,)), 10**9, '1', lambda *_: None, seconds=0.3)\n"
        "print(done.inputs)"
    )
    assert 0 < int(inputs) < 10**9


def engine(code: str) -> str:
    """Run code with the engine in a separate process, because the engine limits the memory."""
    head = (
        "from tests.fuzz import run\nfrom tests.fuzz.shrink import shrunk\nfrom tests.fuzz.target import Subject\n"
        "from tests.fuzz.hungry import hungry\nrun.SECONDS = 0.02\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", head + code], cwd=ROOT, capture_output=True, text=True, timeout=100, check=True
    )
    return done.stdout


@pytest.mark.thorough
@pytest.mark.parametrize(("word", "signature"), [(b"m", "MemoryError"), (b"s", "slow"), (b"w", "KeyError")])
def test_the_engine_detects_each_kind_of_failure(word: bytes, signature: str) -> None:
    code = (
        f"subject = Subject(hungry, [b'xxx'], (ValueError,), [{word!r}], 16)\n"
        "for finding in run.fuzz(subject, 500, '1', lambda number, content: None).findings:\n"
        "    print(finding.signature, finding.content[:1])\n"
    )
    assert any(line.startswith(signature) and line.endswith(repr(word)) for line in engine(code).splitlines())


def test_a_target_whose_seeds_all_fail_is_reported_with_the_traceback() -> None:
    trouble = engine("print(run.fuzz(Subject(hungry, [b'w'], ()), 500, '1', lambda *_: None).findings[0].trouble)")
    assert "the target rejects all seeds" in trouble
    assert "KeyError: b'w'" in trouble


@pytest.mark.thorough
@pytest.mark.parametrize("first", ["w", "boom"])
def test_a_finding_is_shortened(first: str) -> None:
    code = f"print(shrunk(Subject(hungry, [b''], (ValueError,)), {first.encode()!r} + b'long' * 50)[1])\n"
    assert engine(code) == f"b'{first}'\n"


@pytest.mark.thorough
def test_the_same_seed_yields_the_same_inputs() -> None:
    code = (
        "import hashlib\ngiven = []\n"
        "subject = Subject(hungry, [b'xyz', b'def'], (ValueError,))\n"
        "run.fuzz(subject, 500, '7', lambda number, content: given.append(content))\n"
        "print(len(given), hashlib.md5(b' '.join(given)).hexdigest())\n"
    )
    first = engine(code)
    assert first.startswith("500 ")
    assert first == engine(code)


@pytest.mark.thorough
@pytest.mark.parametrize("content", [b"x" * 8000, bytes(range(256)) * 8])
def test_a_findings_text_reproduces_it_without_its_file(content: bytes, tmp_path: Path) -> None:
    text = report("ros1_requests", Finding("hang", content, "Traceback"), 7, tmp_path / "lost")
    assert all(part in text for part in ("ros1_requests", "hang", "seed 7", "Traceback"))
    command = text.rpartition("reproduce: python ")[2].split()
    done = subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True, timeout=100, check=True)
    assert done.stdout == "ros1_requests: passed\n"


def test_a_findings_text_is_bounded(tmp_path: Path) -> None:
    text = report("ros1_requests", Finding("hang", os.urandom(1 << 20), "Traceback"), 7, tmp_path / "long")
    assert len(text) < 5000
    assert f"--file {tmp_path / 'long'}" in text


@pytest.mark.thorough
@pytest.mark.parametrize("failure", ["threading.Event().wait()", "os.kill(os.getpid(), signal.SIGSEGV)"])
def test_a_hang_and_a_crash_are_reported_with_the_stack(monkeypatch: pytest.MonkeyPatch, failure: str) -> None:
    program = (
        "import os, signal, threading\nfrom tests.fuzz import child\nfrom tests.fuzz.target import Subject, Target\n"
        f"def broken_parser(data):\n    if data != b'seed': {failure}\n"
        "child.TARGETS['broken'] = Target('broken', 1, lambda: Subject(broken_parser, [b'seed'], ()))\n"
        "child.shrunk = lambda subject, content: ('', content)\nchild.main()\n"
    )
    monkeypatch.setattr(watch, "_PROGRAM", ("-c", program))
    monkeypatch.setattr(watch, "_STUCK_SECONDS", 0.5)
    monkeypatch.setattr(watch, "_MOST_DEATHS", 1)
    fuzzing = watch.Fuzzing({Target("broken", 1, lambda: Subject(len, [b""], ())): 100}, 1, 1)
    fuzzing.run()
    (finding,) = fuzzing.outcomes["broken"].findings.values()
    assert finding.content != b"seed"
    assert "broken_parser" in finding.trouble
