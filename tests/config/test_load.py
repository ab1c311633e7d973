"""Loading the configuration: accepted files, and every problem's place and cure."""

# ruff: noqa: E501  expected lines are written as they appear

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.config.document import MAX_BYTES, ConfigError
from bridge.config.load import find, load, loads
from bridge.config.model import Config
from bridge.config.sections.routing import Rule
from bridge.daemon.protocol import NewConfig, decode_command, encode_command


def problems(text: str, file: Path = Path("midspan.yaml")) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        loads(text, file)
    return str(caught.value).splitlines()


@pytest.mark.parametrize(
    "text", ["", "# nothing\n", "---\n", "hub:\n", "{}", "hub: {}\nrouting:\n  rules:\n", "routing: {rules: []}"]
)
def test_an_empty_file_has_the_defaults(text: str) -> None:
    assert loads(text) == Config()


def test_values_of_the_file_are_used() -> None:
    config = loads(
        """
        name: robot1
        hub: {domain: 7, listen: "tcp/127.0.0.1:1234", router: false, zenoh: {mode: client}}
        ros1: {enabled: true, master: "http://robot:11311", poll: 1}
        routing:
          default: deny
          rules:
            - {topic: /scan, from: ros1, rate: 5, priority: stream}
            - {regex: '/cam(\\d+)', rename: '/camera\\1', qos: {reliability: best_effort}}
        """
    )
    assert config.name == "robot1"
    assert (config.hub.domain, config.hub.router, config.hub.zenoh) == (7, False, {"mode": "client"})
    assert config.ros1.enabled is True
    assert config.routing.default == "deny"
    assert config.routing.rules[0].from_ == "ros1"
    assert config.routing.rules[1].rename == "/camera\\1"
    assert config.routing.rules[1].qos.reliability == "best_effort"


# the text of a configuration, and all lines of the report, without the file's name
CASES = [
    ("sim: {start: [1, .nan, 3]}", ["1:18: sim.start[1]: input should be a finite number, not nan"]),
    (
        "web: {robots: [{name: a, base_frame: b, radius: .nan}]}",
        ["1:49: web.robots[0].radius: input should be a finite number, not nan"],
    ),
    ("hubb: {}", ["1:1: hubb: unknown key 'hubb'; did you mean 'hub'?"]),
    (
        "routing:\n  rules:\n    - tops: /scan",
        ["3:7: routing.rules[0].tops: unknown key 'tops'; did you mean 'topic'?"],
    ),
    ("listen: tcp/a:1", ["1:1: listen: unknown key 'listen' here; did you mean 'hub.listen'?"]),
    (
        "log: {xyzzy: 1}",
        ["1:7: log.xyzzy: unknown key 'xyzzy'; known here: level"],
    ),
    (
        "log: {level: warn}",
        ["1:14: log.level: 'warn' is not one of debug, info, warning, error; did you mean 'warning'?"],
    ),
    ("ros1: {enabled: 'true'}", ["1:17: ros1.enabled: 'true' is a text here; write true without quotes"]),
    ("ros2: {enabled: [true]}", ["1:17: ros2.enabled: a list is not one of auto, true, false"]),
    ("ros1: {enabled: yes}", ["1:17: ros1.enabled: 'yes' is not one of auto, true, false"]),
    ("hub:\n  domain: 1\n  domain: 2", ["3:3: hub.domain: given twice (first in line 2); keep one"]),
    ("hub: 3", ["1:6: hub: must be a section with keys, not 3"]),
    ("- a\n- b", ["1:1: must be a map of sections, for example 'hub:'"]),
    ("hub: {zenoh: 3}", ["1:14: hub.zenoh: 3 is not a map, or 3 is not a path"]),
    ("types: {folders: 7}", ["1:18: types.folders: 7 is not a list"]),
    ("hub: {domain: 300}", ["1:15: hub.domain: input should be less than or equal to 232, not 300"]),
    ("name: a b", ["1:7: name: 'a b' does not match ^[A-Za-z0-9][A-Za-z0-9_.-]{0,62}$"]),
    (
        "hub: {listen: 'localhost:7447'}",
        [
            (
                "1:15: hub.listen: 'localhost:7447' is not a zenoh endpoint; give protocol and"
                " address, for example tcp/127.0.0.1:7447"
            )
        ],
    ),
    (
        "hub: {listen: 'tcp/0.0.0.0:7447'}",
        [
            (
                "1:15: hub.listen: 'tcp/0.0.0.0:7447' is open to other machines; listen on 127.0.0.1, and let"
                " others in through hub.open ('midspan config migrate' moves the address there)"
            )
        ],
    ),
    (
        "hub:\n  open: {listen: ['tcp/0.0.0.0:7448']}",
        [
            (
                "2:9: hub.open: tcp/0.0.0.0:7448 has no TLS: anybody on that network could join; write"
                " tls/0.0.0.0:7448 and make certificates with 'midspan keys', or set 'insecure: true'"
            )
        ],
    ),
    (
        "hub: {open: {connect: ['tcp/a:7448'], insecure: true, trusted: [a]}}",
        ["1:13: hub.open: without TLS no machine presents a certificate, so none can be recognized as 'a'; use TLS"],
    ),
    (
        "hub: {listen: tcp/127.0.0.1}",
        ["1:15: hub.listen: 'tcp/127.0.0.1' has no port from 0 to 65535; write it like tcp/127.0.0.1:7447"],
    ),
    (
        "hub: {listen: 'tcp/127.0.0.1:99999'}",
        ["1:15: hub.listen: 'tcp/127.0.0.1:99999' has no port from 0 to 65535; write it like tcp/127.0.0.1:7447"],
    ),
    (
        "hub: {open: {connect: tls/robot1}}",
        ["1:23: hub.open.connect: 'tls/robot1' has no port from 0 to 65535; write it like tls/robot1:7447"],
    ),
    (
        "hub: {open: {connect: 'tls/robot1:port'}}",
        ["1:23: hub.open.connect: 'tls/robot1:port' has no port from 0 to 65535; write it like tls/robot1:7447"],
    ),
    (
        "zenoh: {router: 'tcp/[fe80::1%eth0]'}",
        ["1:17: zenoh.router: 'tcp/[fe80::1%eth0]' has no port from 0 to 65535; write it like tcp/[fe80::1%eth0]:7447"],
    ),
    (
        "hub: {open: {connect: 'tls/:7448'}}",
        ["1:23: hub.open.connect: 'tls/:7448' has no host; write it like tls/robot1:7448"],
    ),
    (
        "hub: {open: {trusted: [a]}}",
        ["1:13: hub.open: 'trusted' and 'insecure' have no effect without endpoints; set 'listen' or 'connect'"],
    ),
    (
        "hub: {open: {listen: ['tls/0.0.0.0:7447']}}",
        [
            (
                "1:6: hub: tls/0.0.0.0:7447 uses the same port as hub.listen (tcp/127.0.0.1:7447); choose another,"
                " such as 7448"
            )
        ],
    ),
    (
        "hub: {listen: 'tcp/127.0.0.1:7448', open: {listen: ['tls/0.0.0.0:7448']}}",
        [
            (
                "1:6: hub: tls/0.0.0.0:7448 uses the same port as hub.listen (tcp/127.0.0.1:7448); choose another,"
                " such as 7449"
            )
        ],
    ),
    (
        "hub: {router: false, open: {connect: ['tls/a:7448']}}",
        ["1:6: hub: hub.open needs the daemon's router, but hub.router is false"],
    ),
    (
        "hub: {open: {connect: ['tls/a:7448']}}\nrouting:\n  rules:\n  - {topic: /drive, priority: command}",
        [
            (
                "4:5: routing.rules[0]: with hub.open a command rule needs an exact type, for example 'type:"
                " geometry_msgs/msg/Twist': the external listener recognizes commands by their types"
            )
        ],
    ),
    (
        "ros1: {master: robot}",
        ["1:16: ros1.master: 'robot' is not a master's URI; give for example http://robot:11311"],
    ),
    (
        "ros1: {master: 'http://robot'}",
        [
            (
                "1:16: ros1.master: 'http://robot' has no valid port; a master's is 11311 by"
                " default, for example http://robot:11311"
            )
        ],
    ),
    (
        "ros1: {node: /a}",
        ["1:14: ros1.node: '/a' is not a node name; use letters, digits and underscores, a letter first"],
    ),
    (
        "routing: {rules: [{topic: /a, regex: /b}]}",
        [("1:19: routing.rules[0]: give either 'topic' (a glob) or 'regex', not both")],
    ),
    (
        "routing: {rules: [{regex: '('}]}",
        [("1:27: routing.rules[0].regex: not a regular expression: missing ), unterminated subpattern at position 0")],
    ),
    (
        "routing: {rules: [{topic: scan}]}",
        [
            "1:27: routing.rules[0].topic: 'scan' matches no topic: write /scan, or **/scan for any namespace",
        ],
    ),
    (
        "routing: {rules: [{type: std_msgs/String}]}",
        [
            (
                "1:26: routing.rules[0].type: 'std_msgs/String' matches no type: they are spelled as in ROS 2,"
                " std_msgs/msg/String"
            )
        ],
    ),
    (
        "routing: {rules: [{regex: '/a/(.*)', rename: '/b/\\2'}]}",
        ["1:19: routing.rules[0]: rename '/b/\\\\2' uses group 2, which the regular expression does not have"],
    ),
    (
        "routing: {rules: [{topic: /a/*, rename: /b/*/*}]}",
        ["1:19: routing.rules[0]: rename '/b/*/*' has 2 wildcards, but the topic has only 1 to fill them from"],
    ),
    (
        "routing: {rules: [{topic: /a, rename: b c}]}",
        [
            (
                "1:19: routing.rules[0]: rename 'b c' is not a topic name: begin it with a slash; letters, digits and"
                " underscores make its parts, and none begins with a digit"
            )
        ],
    ),
    (
        "hub: {domain: 1",
        ["1:16: not valid YAML: while parsing a flow mapping expected ',' or '}', but got '<stream end>'"],
    ),
    ("hub: {<<: {domain: 1}}", ["1:7: hub: merge keys (<<) are not supported"]),
    ("{[1]: 2}", ["1:2: a key must be text"]),
    (
        "name: !!python/name:os.system x",
        [("1:7: name: the tag tag:yaml.org,2002:python/name:os.system is not supported; give plain data")],
    ),
    ("hub: {zenoh: /no/such/file}", ["1:14: hub.zenoh: no such file or folder: /no/such/file"]),
    ("types: {folders: [/no/such]}", ["1:19: types.folders[0]: no such file or folder: /no/such"]),
    (
        "hubb: 1\nros2: {domain: -1, nod: x}\nlog: {level: all}\n",
        [
            "1:1: hubb: unknown key 'hubb'; did you mean 'hub'?",
            "2:16: ros2.domain: input should be greater than or equal to 0, not -1",
            "2:20: ros2.nod: unknown key 'nod'; did you mean 'node'?",
            "3:14: log.level: 'all' is not one of debug, info, warning, error",
        ],
    ),
]


START = "The robot's start pose: x, y (meters), direction (degrees)"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("sim: {start: [1]}", f"1:14: sim.start: has 1 value, and needs exactly 3: {START}"),
        ("sim: {start: []}", f"1:14: sim.start: has no values, and needs exactly 3: {START}"),
        ("sim: {start: [1, 2, 3, 4]}", f"1:14: sim.start: has 4 values, and needs exactly 3: {START}"),
        (
            "sim:\n  camera:\n    fov: [60]\n",
            "3:10: sim.camera.fov: has 1 value, and needs exactly 2: Horizontal and vertical field of view, degrees",
        ),
        (
            "modules: {localization_server: {initial_spread: [0.5, 15, 1]}}",
            "1:49: modules.localization_server.initial_spread: has 3 values, and needs exactly 2: Standard deviations of a start pose without a covariance: meters, degrees",
        ),
        (
            "modules: {localization_server: {localiser: {odom_alpha: [0.1, 0.2]}}}",
            "modules.localization_server.localiser.odom_alpha: has 2 values, and needs exactly 5: Noise of odometry,",
        ),
        (
            f"record: {{trigger: {{topics: [{', '.join(f'/t{n}' for n in range(65))}]}}}}",
            "1:28: record.trigger.topics: has 65 values, and needs at most 64",
        ),
        (
            "routing: {parameters: [{ros1: /a, node: /b, owner: ros1, names: []}]}",
            "names: has no values, and needs at least 1",
        ),
    ],
)
def test_a_list_of_the_wrong_length_is_refused_with_the_expected_one(text: str, expected: str) -> None:
    (problem,) = problems(text)
    assert expected in problem


@pytest.mark.parametrize(("text", "expected"), CASES, ids=[text.splitlines()[0] for text, _ in CASES])
def test_problems_have_place_key_and_cure(text: str, expected: list[str]) -> None:
    assert problems(text) == [f"midspan.yaml:{line}" for line in expected]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: &a [*a]\n", "too large or nested too deeply"),
        (
            (
                "a: &a [0,0,0,0,0,0,0,0,0,0]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a,*a]\nc: &c [*b,*b,*b,*b,*b,*b,*b,*b,*b,*b]\n"
                "d: &d [*c,*c,*c,*c,*c,*c,*c,*c,*c,*c]\ne: &e [*d,*d,*d,*d,*d,*d,*d,*d,*d,*d]\nf: [*e,*e]\n"
            ),
            "too large",
        ),
        ("[" * 20000, "not valid YAML"),
        ("a: b\n---\nc: d\n", "but found another document"),
        ("a: *nothing\n", "undefined alias"),
        ("a: \x07\n", "not valid YAML"),
    ],
    ids=["alias of itself", "aliases that multiply", "deep", "two documents", "no such alias", "control character"],
)
def test_hostile_yaml_is_refused(text: str, words: str) -> None:
    assert words in problems(text)[0]


def test_a_file_that_cannot_be_used_is_reported_with_the_reason(tmp_path: Path) -> None:
    large = tmp_path / "large.yaml"
    large.write_bytes(b"#" * (MAX_BYTES + 1))
    latin = tmp_path / "latin.yaml"
    latin.write_bytes("log:\n  level: 'gr\u00fcn'".encode("latin-1"))
    for file, fault in [
        (tmp_path / "missing.yaml", "no such file"),
        (tmp_path, "is not a file"),
        (large, "is larger than"),
        (latin, "latin.yaml:2:13: is not UTF-8: byte 0xfc"),
    ]:
        with pytest.raises(ConfigError, match=fault):
            load(file)


def test_relative_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    for name in ("msg", "more"):
        (tmp_path / name).mkdir()
    (tmp_path / "rules.yaml").touch()
    file = tmp_path / "conf" / "midspan.yaml"
    file.parent.mkdir()
    file.write_text(f"state: st\ntypes: {{folders: [../msg, {tmp_path}/more], mapping_rules: [../rules.yaml]}}\n")
    config = load(file)
    assert config.state == tmp_path / "conf" / "st"
    assert config.types.folders == (tmp_path / "msg", tmp_path / "more")
    assert config.types.mapping_rules == (tmp_path / "rules.yaml",)


def test_a_tilde_is_expanded_to_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("HOME", "USERPROFILE"):  # the second on Windows
        monkeypatch.setenv(name, str(tmp_path))
    assert loads("state: ~/st").state == tmp_path / "st"


@pytest.mark.parametrize(
    ("path", "fault"),
    [
        (f"/{'a' * 300}", f"types.folders[0]: cannot read /{'a' * 300}: File name too long"),
        (
            "~no-such-user/msg",
            "types.folders[0]: the home folder in ~no-such-user/msg is unknown; write the whole path",
        ),
    ],
)
def test_a_path_that_cannot_be_examined_is_a_problem_of_its_key(path: str, fault: str) -> None:
    assert problems(f"types: {{folders: ['{path}']}}") == [f"midspan.yaml:1:19: {fault}"]


@pytest.mark.parametrize(
    "rule",
    [
        {"topic": "/a/**", "rename": "/r1/**"},
        {"topic": "**/image", "rename": "/images/**"},
        {"regex": r"/old(/.*)", "rename": r"\1"},
        {"regex": r"/(?P<who>\w+)/image", "rename": r"/cameras/\g<who>"},
        {"topic": "/a", "to": "ros1", "rename": "/cam/1"},
        {"type": "sensor_msgs/msg/*"},
        {"type": "sensor_msgs/**"},
    ],
)
def test_valid_rules_are_accepted(rule: dict[str, str]) -> None:
    assert Rule.model_validate(rule)


def test_the_configuration_is_searched_from_the_variable_to_the_home_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work, home = tmp_path / "work", tmp_path / "home"
    work.mkdir()
    user = home / ".config" / "midspan" / "midspan.yaml"
    user.parent.mkdir(parents=True)
    monkeypatch.chdir(work)
    environ = {"HOME": str(home)}
    user.write_text("")
    assert find(environ) == user
    (work / "midspan.yaml").write_text("")
    assert find(environ) == Path("midspan.yaml")
    assert find({**environ, "MIDSPAN_CONFIG": "/else/where.yaml"}) == Path("/else/where.yaml")
    (work / "midspan.yaml").unlink()
    for folder in (str(tmp_path / "xdg"), f"/{'a' * 300}"):  # the second cannot be examined
        assert find({**environ, "XDG_CONFIG_HOME": folder}) in {None, Path("/etc/midspan/midspan.yaml")}


def test_a_worker_receives_the_same_configuration(tmp_path: Path) -> None:
    config = loads(
        f"state: {tmp_path}\nrouting: {{rules: [{{topic: /a, from: ros1, rename: /b}}]}}\nhub: {{zenoh: {{mode: client}}}}"
    )
    sent = decode_command(encode_command(NewConfig(config)))
    assert sent == NewConfig(config)
