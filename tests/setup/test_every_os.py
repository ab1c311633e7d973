"""Checks of the workflow for systems that CI does not have, and of the file for launchd; CI cannot run either."""

from __future__ import annotations

import os
import plistlib
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml

from tests.setup.installed import Installed

ROOT = Path(__file__).parents[2]
WORKFLOW = ROOT / ".github/workflows/every_os.yml"
JOB_KEYS = {"needs", "strategy", "runs-on", "timeout-minutes", "defaults", "steps"}
HIDING = "tests.support.any_os"
STEP_KEYS = {"name", "uses", "with", "run", "env"}


RUNNERS = {"macos-26", "ubuntu-24.04", "ubuntu-24.04-arm", "windows-2025"}
"""Labels of GitHub's own machines; a job with another label waits for a day, and then fails."""

INPUTS = {
    "actions/checkout": {"persist-credentials"},
    "actions/download-artifact": {"merge-multiple", "path", "pattern"},
    "actions/setup-python": {"python-version"},
    "actions/upload-artifact": {"if-no-files-found", "name", "path"},
}
"""Inputs of the actions; GitHub ignores an input that an action does not have, and only warns."""


@pytest.fixture(scope="module")
def workflow() -> dict[Any, Any]:
    document: dict[Any, Any] = yaml.safe_load(WORKFLOW.read_text(encoding="utf-8"))
    return document


def steps(workflow: dict[Any, Any]) -> list[dict[str, Any]]:
    return [step for job in workflow["jobs"].values() for step in job["steps"]]


def test_jobs_have_only_keys_that_github_knows(workflow: dict[Any, Any]) -> None:
    # YAML 1.1 reads the key "on" as true
    assert set(workflow) == {"name", True, "permissions", "concurrency", "jobs"}
    assert workflow["permissions"] == {"contents": "read"}
    for job in workflow["jobs"].values():
        assert set(job) <= JOB_KEYS
        assert set([job["needs"]] if "needs" in job else []) <= set(workflow["jobs"])
        assert job["timeout-minutes"] <= 60


def test_each_step_uses_an_action_or_runs_a_valid_script(workflow: dict[Any, Any]) -> None:
    for step in steps(workflow):
        assert set(step) <= STEP_KEYS
        assert ("uses" in step) != ("run" in step), step
        if "uses" in step:
            assert re.fullmatch(r"[\w-]+/[\w-]+@(v[0-9]+|[0-9a-f]{40})", step["uses"])
        else:
            checked = subprocess.run(["bash", "-n"], input=step["run"], capture_output=True, text=True, check=False)
            assert (checked.returncode, checked.stderr) == (0, "")


class UniqueKeys(yaml.SafeLoader):
    """Rejects a mapping with two equal keys, as GitHub does."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        mapping = super().construct_mapping(node, deep)
        assert len(mapping) == len(node.value), f"two equal keys in {WORKFLOW.name}{node.start_mark}"
        return mapping


def test_no_mapping_has_two_equal_keys() -> None:
    yaml.load(WORKFLOW.read_text(encoding="utf-8"), UniqueKeys)
    with pytest.raises(AssertionError, match="two equal keys"):
        yaml.load("run: a\nrun: b\n", UniqueKeys)


def test_events_machines_and_inputs_are_valid_on_github(workflow: dict[Any, Any]) -> None:
    events = {"push": {"branches": ["main"]}, "pull_request": None, "workflow_dispatch": None}
    assert workflow[True] == events
    assert set(workflow["concurrency"]) == {"group", "cancel-in-progress"}
    for job in workflow["jobs"].values():
        assert job["runs-on"] == "${{ matrix.os }}"
        assert set(job["strategy"]) <= {"fail-fast", "matrix"}
        assert set(job["strategy"]["matrix"]["os"]) <= RUNNERS
        assert job.get("defaults", {}) in ({}, {"run": {"shell": "bash"}}), "Windows has another shell by default"
    assert [v for v in workflow["jobs"]["run"]["strategy"]["matrix"]["python"] if not isinstance(v, str)] == []
    for step in steps(workflow):
        assert set(step.get("with", {})) <= INPUTS.get(step.get("uses", "").partition("@")[0], set()), step
        assert "name" in step or "uses" in step
        assert all(isinstance(value, str) for value in step.get("env", {}).values())


def test_the_wheels_that_one_job_uploads_are_installed_in_the_other(workflow: dict[Any, Any]) -> None:
    *_, upload = workflow["jobs"]["wheels"]["steps"]
    download, install = workflow["jobs"]["run"]["steps"][2:4]
    assert upload["with"]["name"] == download["with"]["pattern"].replace("*", "${{ matrix.os }}")
    assert download["with"]["merge-multiple"] is True, "otherwise each artifact gets its own folder"
    assert upload["with"]["path"] == f"{download['with']['path']}/"
    assert ["--find-links", download["with"]["path"]] == shlex.split(install["run"].splitlines()[1])[4:6]


def test_expressions_refer_to_existing_values(workflow: dict[Any, Any]) -> None:
    matrix = workflow["jobs"]["run"]["strategy"]["matrix"]
    assert set(workflow["jobs"]["wheels"]["strategy"]["matrix"]["os"]) == {"ubuntu-24.04", "ubuntu-24.04-arm"}
    known = {f"matrix.{name}" for name in matrix} | {"github.ref"}
    expressions = re.findall(r"\$\{\{\s*(.*?)\s*\}\}", WORKFLOW.read_text(encoding="utf-8"))
    assert expressions
    assert set(expressions) <= known
    assert {name.partition("-")[0] for name in matrix["os"]} == {"ubuntu", "windows", "macos"}
    assert "ubuntu-24.04-arm" in matrix["os"]


def test_files_and_targets_of_its_commands_exist(workflow: dict[Any, Any]) -> None:
    words = [word for step in steps(workflow) for word in shlex.split(step.get("run", ""))]
    paths = [word for word in words if word.startswith(("tests/", "configs/"))]
    assert "tests/daemon/test_other_os.py" in paths
    assert [path for path in paths if not (ROOT / path).exists()] == []
    assert re.search(r"^dist:", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert "MIDSPAN_TEST_SYSTEMS" in (ROOT / "tests/daemon/test_other_os.py").read_text()


@pytest.mark.thorough
@pytest.mark.timeout(600)
def test_all_its_tests_can_be_collected_without_what_windows_lacks(workflow: dict[Any, Any]) -> None:
    for words in (shlex.split(step["run"]) for step in steps(workflow) if "-m pytest" in step.get("run", "")):
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *words[words.index("pytest") + 1 :], "--collect-only", "-p", HIDING],
            cwd=ROOT, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr


@pytest.mark.long
@pytest.mark.timeout(600)
def test_its_last_step_passes_with_the_packages_that_it_installs(workflow: dict[Any, Any], tmp_path: Path) -> None:
    """The temporary folder's path is longer than on macOS."""
    *_, install, _, _, last = workflow["jobs"]["run"]["steps"]
    commands = [shlex.split(line)[4:] for line in install["run"].splitlines()]
    words = {word for command in commands for word in command if word[0] != "-"} - {"pip", "dist"}
    assert {"midspan[web]", "pytest"} <= words
    python, *arguments = shlex.split(last["run"])
    environment = Installed(tmp_path / "venv", [], sorted(words))
    environ = {**environment.environ(), "CI": "true", "TMPDIR": str(tmp_path), **last.get("env", {})}
    bytecode = {name: value for name, value in os.environ.items() if name == "PYTHONPYCACHEPREFIX"}
    done = subprocess.run(
        [environment.bin / python, *arguments],
        cwd=ROOT, env={**environ, **bytecode}, capture_output=True, text=True, timeout=500, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr
    passed = re.search(r"([0-9]+) passed", done.stdout)
    assert passed, done.stdout[-500:]
    assert int(passed[1]) > 2000


def test_a_checkout_on_windows_has_the_same_bytes() -> None:
    command = ["git", "check-attr", "text", "tests/yarp_compat/data/portables.txt"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.endswith(": text: unset\n"), "without it, git for Windows writes CRLF"


def test_set_up_installs_nothing_for_midspans_own_ci(workflow: dict[Any, Any]) -> None:
    """GitHub sets CI=true, which makes set-up fail if anything is unavailable, such as rospy on Ubuntu."""
    making = [step for step in steps(workflow) if "make" in shlex.split(step.get("run", ""))]
    assert [step["env"] for step in making] == [{"CI": ""}]


def test_launchd_gets_a_valid_file() -> None:
    job = plistlib.loads((ROOT / "packaging/midspan.plist").read_bytes())
    assert (job["Label"], job["RunAtLoad"], job["KeepAlive"]) == ("midspan", True, {"SuccessfulExit": False})
    assert job["UserName"] == "@USER@", "the daemon does not run as root"
    assert job["SoftResourceLimits"] == job["HardResourceLimits"] == {"NumberOfFiles": 49152}, "macOS' default is 256"
    assert job["ProgramArguments"][1:] == ["run", "--config", "/etc/midspan/midspan.yaml"]
    page = (ROOT / "docs/start/pip.md").read_text("utf-8")
    assert """sed "s/@USER@/$USER/" /opt/midspan/share/midspan/packaging/midspan.plist""" in page
    assert f"`{job['StandardErrorPath'].replace('/Users/@USER@', '~')}`" in page


def test_the_task_of_windows_does_not_end_by_itself() -> None:
    """With the Task Scheduler's defaults, which these settings replace, the daemon would end or be slow."""
    task = ET.parse(ROOT / "packaging/midspan-task.xml").getroot()
    space = task.tag.partition("}")[0] + "}"

    def text(path: str) -> str | None:
        return task.findtext("/".join(f"{space}{name}" for name in path.split("/")))

    assert text("Triggers/TimeTrigger/Repetition/Interval") == "PT1M"
    assert text("Settings/MultipleInstancesPolicy") == "IgnoreNew", "the repetition does not start a second daemon"
    assert text("Settings/ExecutionTimeLimit") == "PT0S"
    assert text("Settings/DisallowStartIfOnBatteries") == text("Settings/StopIfGoingOnBatteries") == "false"
    assert text("Settings/Priority") == "4"
    arguments = text("Actions/Exec/Arguments") or ""
    inner = re.fullmatch(r'/c "(.+)"', arguments)  # cmd removes the outer quotes
    assert inner is not None
    words = shlex.split(inner[1].replace("\\", "/"))
    assert words == [
        "C:/midspan/Scripts/midspan.exe",
        "run",
        "--config",
        "C:/midspan/midspan.yaml",
        "2>>",
        "C:/midspan/midspan.log",
    ]
    page = (ROOT / "docs/start/pip.md").read_text("utf-8")
    assert "packaging\\midspan-task.xml) -User" in page
    assert "packaging/*.xml" in (ROOT / "pyproject.toml").read_text("utf-8")
