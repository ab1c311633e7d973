"""The systemd services: the installed files, and systemd's own checks of them."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bridge.cli.main import main
from bridge.config.load import load
from bridge.daemon.install import UNIT_FOLDER, UNITS

ROOT = Path(__file__).parents[2]


def units(root: Path) -> list[str]:
    return [(root / UNIT_FOLDER / name).read_text() for name in UNITS]


def test_install_writes_units_configuration_and_user(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["install", "--root", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "systemctl enable --now midspan-router midspan" in printed
    assert "systemd-sysusers" in printed
    for text in units(tmp_path):
        assert "@MIDSPAN@" not in text
        command = re.search(r"^ExecStart=(.+)", text, re.MULTILINE)
        assert command is not None
        assert os.access(shlex.split(command[1])[0], os.X_OK)
    load(tmp_path / "etc/midspan/midspan.yaml")
    assert (tmp_path / "etc/midspan/environment").stat().st_mode & 0o777 == 0o640
    assert "u midspan " in (tmp_path / "etc/sysusers.d/midspan.conf").read_text()


def test_administrators_files_are_kept_and_others_updated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["install", "--root", str(tmp_path)])
    own_file = tmp_path / "etc/midspan/midspan.yaml"
    own_file.write_text("name: mine\n")
    unit = tmp_path / UNIT_FOLDER / "midspan.service"
    unit.write_text("old")
    capsys.readouterr()
    main(["install", "--root", str(tmp_path)])
    printed = capsys.readouterr().out
    assert own_file.read_text() == "name: mine\n"
    assert f"kept       {own_file}" in printed
    assert re.search(rf"replaced +{unit}", printed)
    assert f"unchanged  {tmp_path / UNIT_FOLDER / 'midspan-router.service'}" in printed
    main(["install", "--root", str(tmp_path), "--uninstall"])
    assert own_file.exists()
    assert not unit.exists()
    assert not (tmp_path / "etc/sysusers.d/midspan.conf").exists()


def test_dry_run_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["install", "--root", str(tmp_path), "--dry-run"]) == 0
    assert "would be written" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
    assert main(["install", "--root", str(tmp_path), "--uninstall"]) == 0
    assert "services are not installed below" in capsys.readouterr().out


def test_install_for_another_user_writes_that_user_into_the_units(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["install", "--root", str(tmp_path), "--user", "robot"]) == 0
    assert all("\nUser=robot\n" in text for text in units(tmp_path))
    assert not (tmp_path / "etc/sysusers.d").exists()
    assert main(["install", "--root", str(tmp_path), "--user", "no\nExecStart=/bin/sh"]) == 1
    assert "is not a user name" in capsys.readouterr().err


TEMPLATES = {"midspan@.service": "midspan.service", "midspan-router@.service": "midspan-router.service"}


def test_an_instance_runs_the_configuration_of_its_name(tmp_path: Path) -> None:
    """Template and main unit differ only in these lines, so this test fails if only one of them is changed."""
    main(["install", "--root", str(tmp_path)])
    folder = tmp_path / UNIT_FOLDER
    for template, single in TEMPLATES.items():
        template_lines, unit_lines = (
            {line for line in (folder / name).read_text().splitlines() if not line.startswith(("#", "Description="))}
            for name in (template, single)
        )
        command = next(line for line in template_lines if line.startswith("ExecStart="))
        router = "router" in template
        assert command.endswith(f"--config /etc/midspan/%i.yaml{'' if router else ' --adopt router'}")
        assert template_lines - unit_lines - {command} == {
            "AssertPathExists=/etc/midspan/%i.yaml",
            "EnvironmentFile=-/etc/midspan/%i.environment",
            "LogsDirectory=midspan/%i",
            "Environment=ROS_LOG_DIR=/var/log/midspan/%i",
            *(
                ()
                if router
                else (f"{key}=network-online.target midspan-router@%i.service" for key in ("Wants", "After"))
            ),
        }
        assert {line.partition("=")[0] for line in unit_lines - template_lines} <= {
            "ExecStart", "LogsDirectory", "Environment", "RuntimeDirectory", "Wants", "After",
        }  # fmt: skip
        assert "EnvironmentFile=-/etc/midspan/environment" in template_lines & unit_lines


def test_the_services_name_all_four_sides(tmp_path: Path) -> None:
    main(["install", "--root", str(tmp_path)])
    for name in ("midspan.service", "midspan@.service"):
        (line,) = re.findall(r"^Description=(.+)$", (tmp_path / UNIT_FOLDER / name).read_text(), re.MULTILINE)
        assert all(side in line for side in ("ROS 1", "ROS 2", "YARP", "zenoh"))


def test_systemd_accepts_instances(tmp_path: Path) -> None:
    """Given a unit name instead of a path, `systemd-analyze verify` loads the unit as `systemctl start` does."""
    main(["install", "--root", str(tmp_path)])
    for instance in ("robot2", "robot-3", "my_bridge_domain2"):
        for template in TEMPLATES:
            done = analyze(tmp_path, "verify", "--man=no", template.replace("@", f"@{instance}"))
            assert (done.returncode, [line for line in done.stderr.splitlines() if "midspan" in line]) == (0, [])


def test_uninstall_names_the_instances_to_disable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["install", "--root", str(tmp_path)])
    assert "systemctl enable --now midspan-router@NAME midspan@NAME" in capsys.readouterr().out
    wants = tmp_path / UNIT_FOLDER / "multi-user.target.wants"
    wants.mkdir()
    for name in ("midspan@robot2", "midspan-router@robot2", "midspan"):
        (wants / f"{name}.service").symlink_to("/nowhere")
    own_file = tmp_path / "etc/midspan/robot2.yaml"
    own_file.write_text("name: robot2\n")
    main(["install", "--root", str(tmp_path), "--uninstall"])
    printed = capsys.readouterr().out
    assert "systemctl disable --now midspan midspan-router midspan@robot2 midspan-router@robot2" in printed
    assert own_file.exists()
    assert not list((tmp_path / UNIT_FOLDER).glob("midspan*@*"))


def test_the_units_permit_what_the_middlewares_need(tmp_path: Path) -> None:
    main(["install", "--root", str(tmp_path)])
    for text in units(tmp_path):
        lines = text.splitlines()
        assert "RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK" in lines
        assert not any(line.startswith(("PrivateIPC=", "PrivateNetwork=")) for line in lines)
        assert {
            "MemoryDenyWriteExecute=yes",
            "StateDirectory=midspan",
            "CacheDirectory=midspan",
            "LimitNOFILE=65536",
        } <= set(lines)
        assert ("LimitMEMLOCK=infinity" in lines) == (" run " in text), "only workers use shared memory"
        assert "ROS_LOG_DIR=/var/log/midspan" in text


def systemd_analyze() -> str:
    program = shutil.which("systemd-analyze")
    if program is None:
        assert not os.environ.get("CI"), "CI needs systemd-analyze: apt install systemd"
        pytest.skip("systemd-analyze is not installed (apt install systemd)")
    return program


def analyze(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "SYSTEMD_UNIT_PATH": f"{root / UNIT_FOLDER}:", "SYSTEMD_COLORS": "0"}
    return subprocess.run([systemd_analyze(), *arguments], env=env, capture_output=True, text=True, check=False)


def test_systemd_finds_nothing_wrong(tmp_path: Path) -> None:
    main(["install", "--root", str(tmp_path)])
    for name in UNITS:
        done = analyze(tmp_path, "verify", "--man=no", "--recursive-errors=yes", str(tmp_path / UNIT_FOLDER / name))
        ours = [line for line in (done.stdout + done.stderr).splitlines() if "midspan" in line]
        assert ours == []
        assert done.returncode == 0, done.stderr


def test_systemd_would_find_a_mistake(tmp_path: Path) -> None:
    main(["install", "--root", str(tmp_path)])
    unit = tmp_path / UNIT_FOLDER / "midspan.service"
    unit.write_text(unit.read_text().replace("WatchdogSec=10", "WatchdogSecs=10"))
    done = analyze(tmp_path, "verify", "--man=no", str(unit))
    assert "WatchdogSecs" in done.stdout + done.stderr


def test_units_are_hardened(tmp_path: Path) -> None:
    """Systemd 252 rates their exposure as 1.7 of 10; a unit without any hardening has 9.6."""
    main(["install", "--root", str(tmp_path)])
    for name in UNITS:
        done = analyze(tmp_path, "security", "--offline=yes", "--no-pager", str(tmp_path / UNIT_FOLDER / name))
        level = re.search(r"Overall exposure level for (\S+): ([\d.]+) (\w+)", done.stdout)
        assert level is not None, done.stdout + done.stderr
        assert float(level[2]) < 2.5, done.stdout


def test_the_user_of_the_services_can_be_created(tmp_path: Path) -> None:
    program = shutil.which("systemd-sysusers")
    if program is None:
        pytest.skip("systemd-sysusers is not installed (apt install systemd)")
    main(["install", "--root", str(tmp_path)])
    subprocess.run([program, f"--root={tmp_path}"], capture_output=True, check=True)
    assert re.search(r"^midspan:x:\d+:\d+:[^:]*:/var/lib/midspan:", (tmp_path / "etc/passwd").read_text(), re.MULTILINE)


def test_seal_forbids_executable_memory_as_the_units_do() -> None:
    """The demo's tests seal all workers (tests/demo/test_demo.py): check that sealing works."""
    program = (
        "import mmap; from tests.support.sealed import seal\n"
        "if not seal(): raise SystemExit(2)\n"
        "mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode == 2:
        pytest.skip("this kernel cannot seal a process (Linux 6.3 can)")
    assert "PermissionError" in done.stderr
