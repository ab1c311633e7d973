"""Values of the right type with which a part of Midspan could not start are refused when a file is loaded."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.config.document import ConfigError
from bridge.config.load import loads

PORT_0 = "has port 0, to which no program can connect; give the listener's port"
NOT_A_HOST = "is not an address or a host name; write it like 192.168.1.20 or robot1.local"
NOT_A_TOPIC = "is not a topic name: begin it with a slash; letters, digits and underscores make its parts"
NOT_A_PORT = "is not a name of a YARP port below `prefix`: write it as aux_control:i"


def base(keys: str) -> str:
    return f"modules: {{base_control: {{enabled: true, {keys}}}}}"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("hub: {listen: 'tcp/127.0.0.1:0'}", f"hub.listen: 'tcp/127.0.0.1:0' {PORT_0}"),
        ("hub: {open: {connect: 'tls/robot:0'}}", f"hub.open.connect: 'tls/robot:0' {PORT_0}"),
        ("zenoh: {router: 'tcp/robot:00#a=b'}", f"zenoh.router: 'tcp/robot:00#a=b' {PORT_0}"),
        (
            "zenoh: {zenoh: {connect: {endpoints: ['tcp/robot:0']}}}",
            f"zenoh.zenoh.connect.endpoints[0]: 'tcp/robot:0' {PORT_0}",
        ),
        ("ros1: {master: 'http://robot:0'}", "ros1.master: 'http://robot:0' has no valid port"),
        ("ros1: {ip: 'a b'}", f"ros1.ip: 'a b' {NOT_A_HOST}"),
        ("ros1: {hostname: 'http://robot'}", f"ros1.hostname: 'http://robot' {NOT_A_HOST}"),
        ("yarp: {ip: '10.0.0.1 '}", f"yarp.ip: '10.0.0.1 ' {NOT_A_HOST}"),
        (base("kind: ikart"), "base_control.kind: 'ikart' is not one of cer, ikart_V1; did you mean 'ikart_V1'?"),
        (base("joints: [a]"), "base_control.joints: names 1, but a base of the kind cer has 2 wheels"),
        (base("odom: 'a b'"), f"base_control.odom: 'a b' {NOT_A_TOPIC}"),
        (base("wheel_command: ''"), f"base_control.wheel_command: '' {NOT_A_TOPIC}"),
        (base("joint_states: wheels"), f"base_control.joint_states: 'wheels' {NOT_A_TOPIC}"),
        (base("inputs: [{name: x, twist: [cmd_vel]}]"), f"inputs[0].twist[0]: 'cmd_vel' {NOT_A_TOPIC}"),
        (base("inputs: [{name: x, joy: ['']}]"), f"inputs[0].joy[0]: '' {NOT_A_TOPIC}"),
        (base("inputs: [{name: x, ports: ['a b:i']}]"), f"inputs[0].ports[0]: 'a b:i' {NOT_A_PORT}"),
    ],
)
def test_values_with_which_a_part_could_not_start_are_refused(text: str, problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        loads(text)
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "hub: {open: {listen: 'tls/0.0.0.0:0'}}",
        "ros1: {ip: 'fe80::1%eth0', hostname: robot-1.local}",
        "ros1: {hostname: ''}",
        base("kind: ikart_V1, joints: [a, b, c]"),
        base("inputs: [{name: x, twist: [/cmd_vel], ports: [/far/control:i, input/joystick, aux_control:i]}]"),
    ],
)
def test_similar_values_with_which_it_can_start_are_accepted(text: str) -> None:
    assert loads(text)


@pytest.mark.parametrize(
    "key",
    [
        "modules: {base_control: {enabled: true, ini: PATH}}",
        "store: {maps: PATH}",
        "ros2: {profile: PATH}",
        "sim: {enabled: true, plan: PATH}",
    ],
)
def test_a_folder_in_place_of_a_file_is_refused(key: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"{tmp_path} is a folder, not a file"):
        loads(key.replace("PATH", str(tmp_path)))


@pytest.mark.parametrize(
    "key",
    [
        "state: PATH",
        "types: {folders: [PATH]}",
        "hub: {open: {keys: PATH}}",
        "record: {enabled: true, folder: PATH}",
        "ros1: {packages: PATH}",
        "modules: {map2d_server: {enabled: true, folder: PATH}}",
    ],
)
def test_a_file_in_place_of_a_folder_is_refused(key: str, tmp_path: Path) -> None:
    (file := tmp_path / "a").touch()
    with pytest.raises(ConfigError, match=f"{file} is a file, not a folder"):
        loads(key.replace("PATH", str(file)))


@pytest.mark.parametrize(
    "text", ["sim: {enabled: false, plan: gone/plan.yaml}", "modules: {base_control: {ini: gone.ini}}"]
)
def test_what_is_off_needs_no_files(text: str) -> None:
    assert loads(text)
