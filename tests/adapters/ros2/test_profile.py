"""The generated Fast DDS profile, and a user's custom profile."""

from __future__ import annotations

import os
import re
import stat
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from bridge.adapters.ros2 import own_profile, profile_file
from bridge.adapters.ros2 import profile as profile_module
from bridge.adapters.ros2.dds import fast
from bridge.adapters.ros2.graph.origins import is_marked, new_prefix
from bridge.adapters.ros2.profile import FastDdsProfile, stamped, use_profile
from bridge.config.model import Config
from tests.peers.ros2 import kilted
from tests.peers.ros2.network import ros2_environment

PREFIX = new_prefix(b"\x01\x0f\x12\x34")
SPACE = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"


def texts(xml: str, tag: str) -> list[str | None]:
    return [element.text for element in ET.fromstring(xml).iter(SPACE + tag)]


def test_a_local_profile_uses_shared_memory_and_udp_on_loopback() -> None:
    xml = FastDdsProfile(PREFIX, 32 << 20, localhost_only=True).xml()
    assert texts(xml, "type") == ["SHM", "UDPv4"]
    assert texts(xml, "segment_size") == [str(32 << 20)]
    assert texts(xml, "prefix") == [PREFIX.hex(".")]
    assert texts(xml, "address") == ["127.0.0.1", "239.255.0.1", "127.0.0.1"]
    (times,) = ET.fromstring(xml).iter(SPACE + "times")
    assert [[child.text for child in time] for time in times] == [["0", "500000000"], ["0", "100000000"]]


def test_a_profile_without_shared_memory_uses_udp_on_all_interfaces() -> None:
    xml = FastDdsProfile(PREFIX, 0, localhost_only=False).xml()
    assert texts(xml, "type") == ["UDPv4"]
    assert texts(xml, "interfaceWhiteList") == []


_LOAD = f"""
import os, sys
from bridge.adapters.ros2.profile import FastDdsProfile
path = sys.argv[1]
with open(path, "w") as file:
    file.write(FastDdsProfile({PREFIX!r}, 0, localhost_only=True).xml())
os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] = path
import rclpy
rclpy.init()
rclpy.create_node("loads_the_profile").destroy_node()
"""


def test_fast_dds_3_accepts_the_profile(tmp_path: Path) -> None:
    """One unknown element makes Fast DDS reject the whole file; `test_messages` loads the profile with Fast DDS 2."""
    env, root = kilted.source(ros2_environment()), Path(__file__).parents[3]
    command = [sys.executable, "-P", "-c", _LOAD, tmp_path / "profile.xml"]
    env["PYTHONPATH"] += f"{os.pathsep}{root}"
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("space", ["", ' xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"'])
def test_a_custom_profile_gets_the_mark(tmp_path: Path, space: str) -> None:
    custom = tmp_path / "own.xml"
    custom.write_text(
        f"""<dds{space}><profiles><participant profile_name="other"><rtps/></participant>
        <participant profile_name="p" is_default_profile="true"><rtps><name>kept</name><prefix>1.2</prefix></rtps>
        </participant></profiles></dds>"""
    )
    xml = stamped(custom, PREFIX)
    assert texts(xml, "prefix") == [PREFIX.hex(".")]
    assert texts(xml, "name")[-2:] == ["fastdds.ignore_local_endpoints", "fastdds.type_propagation"]
    assert texts(xml, "value") == ["true", "disabled"]
    assert "<name>kept</name>" in xml


@pytest.mark.parametrize(("text", "why"), [("<dds", "not XML"), ("<dds/>", "is_default_profile")])
def test_an_unusable_custom_profile_is_rejected(tmp_path: Path, text: str, why: str) -> None:
    custom = tmp_path / "own.xml"
    custom.write_text(text)
    with pytest.raises(ValueError, match=why):
        stamped(custom, PREFIX)


@pytest.fixture
def full_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a state folder that no process can create, in a process that has not loaded a profile."""
    monkeypatch.setattr(profile_module, "_loaded", [])
    monkeypatch.setattr(profile_module, "_temporary", [])
    monkeypatch.setattr("bridge.adapters.ros2.rcl.host_prefix", lambda: b"\x01\x0f\x12\x34")
    monkeypatch.setattr(os, "environ", os.environ.copy())
    (tmp_path / "file").touch()
    return tmp_path / "file" / "state"


UDP_ONLY = Config.model_validate({"ros2": {"transport": "udp"}})


def test_a_profile_that_the_state_folder_refuses_is_a_regular_file_elsewhere(full_state: Path, tmp_path: Path) -> None:
    os.environ["XDG_RUNTIME_DIR"] = str(tmp_path)
    profile = use_profile(UDP_ONLY, full_state)
    path = Path(os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"])
    real = Path(os.path.realpath(path))  # Fast DDS opens this
    assert real.is_file()
    assert real.read_text(encoding="utf-8") == profile.xml()
    assert stat.S_IMODE(real.stat().st_mode) == 0o600
    assert (path.parent, path.name.split("-")[:2]) == (tmp_path, ["midspan", str(os.getpid())])
    profile_module.remove_temporary()
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


def test_a_profile_is_written_to_the_first_usable_folder(
    full_state: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(profile_module, "_other_folders", lambda: [str(full_state), str(tmp_path)])
    use_profile(UDP_ONLY, full_state)
    path = Path(os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"])
    assert path.parent == tmp_path
    profile_module.remove_temporary()


def test_without_any_folder_for_the_profile_no_participant_is_created(
    full_state: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(profile_module, "_other_folders", lambda: [str(full_state)])
    monkeypatch.setattr(fast, "Participant", lambda *_: pytest.fail("an unmarked participant"))
    reason = (
        f"cannot write the Fast DDS profile to {full_state / 'ros2'} or another folder ({full_state}: Not a directory)"
    )
    with pytest.raises(RuntimeError, match=f"{re.escape(reason)}; free space"):
        fast.FastDds(UDP_ONLY).join(full_state, "midspan")


_JOIN = """
import pathlib, sys
from bridge.config.model import Config
from bridge.messages.registry import Registry
from tests.adapters.ros2.conftest import RunningEdge
running = RunningEdge(Registry(), pathlib.Path(sys.argv[1]))
participants = running.edge._context.participant.participants()
print(*(gid.hex() for gid in participants), running.edge._prefix.hex(), flush=True)
running.edge.stop()
"""


def test_a_participant_without_a_usable_state_folder_carries_the_mark(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    env = {**ros2_environment(), "XDG_RUNTIME_DIR": str(tmp_path)}
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", _JOIN, tmp_path / "file" / "state"],
        cwd=root, env=env, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    *participants, prefix = map(bytes.fromhex, done.stdout.splitlines()[-1].split())
    assert [gid[:12] for gid in participants] == [prefix], done.stderr
    assert is_marked(prefix)
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


SHM = """<transport_descriptors><transport_descriptor><transport_id>own</transport_id><type>SHM</type>
<segment_size>4000000</segment_size></transport_descriptor></transport_descriptors>"""
USER = "<userTransports><transport_id>own</transport_id></userTransports>"
ONLY_USER = "<useBuiltinTransports>false</useBuiltinTransports>"
UDP = SHM.replace("SHM", "UDPv4")


@pytest.mark.parametrize(
    ("transports", "rtps", "size"),
    [
        ("", "", 512 << 10),
        ("", "<builtinTransports>LARGE_DATA</builtinTransports>", 512 << 10),
        ("", "<builtinTransports>UDPv4</builtinTransports>", 0),
        ("", ONLY_USER, 0),
        (SHM, USER + ONLY_USER, 4_000_000),
        (SHM, ONLY_USER, 0),
        (UDP, USER + ONLY_USER, 0),
        (UDP, USER, 512 << 10),
    ],
)
def test_the_size_of_a_custom_profiles_shared_memory_is_known(
    tmp_path: Path, transports: str, rtps: str, size: int
) -> None:
    custom = own(tmp_path, transports, rtps)
    assert own_profile.segment(profile_file.read(custom)) == size
    assert own_profile.trouble(custom, tmp_path) == ""
    if Path("/sys").is_mount():  # a file system without any space
        trouble = own_profile.trouble(custom, Path("/sys"))
        assert trouble.startswith(f"ros2.profile {custom} makes Fast DDS use shared memory, but /sys ") is bool(size)


def own(folder: Path, transports: str = "", rtps: str = "") -> Path:
    """Write a custom profile; return its file."""
    participant = f'<participant profile_name="p" is_default_profile="true"><rtps>{rtps}</rtps></participant>'
    file = folder / "own.xml"
    file.write_text(f'<dds xmlns="urn:x"><profiles>{transports}{participant}</profiles></dds>')
    return file


def test_a_custom_profile_without_room_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    if not Path("/sys").is_mount():
        pytest.skip("/sys is no file system without any space")
    custom = own(tmp_path)
    monkeypatch.setattr(own_profile.trouble, "__defaults__", (Path("/sys"),))
    monkeypatch.setattr(fast, "use_profile", lambda *_: FastDdsProfile(PREFIX, 0, localhost_only=True))
    monkeypatch.setattr(fast, "Participant", lambda *_: None)
    dds = fast.FastDds(Config.model_validate({"ros2": {"profile": str(custom)}}))
    dds.join(tmp_path, "midspan")
    (record,) = (record for record in caplog.records if record.name == fast.__name__)
    assert str(custom) in record.getMessage()
    assert dds.warnings([], []) == [record.getMessage()]
