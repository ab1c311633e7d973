"""zenoh's own settings in a configuration: each mistake is refused with its location before a session is opened."""

# ruff: noqa: E501  expected lines are written as they appear

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path

import pytest
import zenoh

from bridge.cli.main import main
from bridge.config.document import ConfigError
from bridge.config.load import load, loads

PROTOCOLS = "tcp, udp, tls, quic, ws, unixsock-stream"

RULE = "{id: r, messages: [put], flows: [ingress], permission: allow, key_exprs: [a]}"
NO_RULES = "rules: [], subjects: [], policies: []"
ALLOWS_NOTHING = (
    "allows nothing: no policy has a rule with 'permission: allow'; add one, or 'default_permission: allow'"
)


def problems(text: str, file: Path = Path("m.yaml")) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        loads(text, file)
    return str(caught.value).splitlines()


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("hub: {zenoh: {mod: peer}}", ["m.yaml:1:15: hub.zenoh.mod: zenoh has no key 'mod' here; did you mean 'mode'?"]),
        (
            "hub: {router_zenoh: {stats: {zzz: 1}}}",
            ["m.yaml:1:30: hub.router_zenoh.stats.zzz: zenoh has no key 'zzz' here: filters"],
        ),
        (
            "hub:\n  zenoh:\n    mode: pear\n    transport: {link: {tx: {leese: 3000, lease: soon}}}",
            [
                "m.yaml:3:5: hub.zenoh.mode: 'pear' is not one of router, peer, client; did you mean 'peer'?",
                "m.yaml:4:29: hub.zenoh.transport.link.tx.leese: zenoh has no key 'leese' here; did you mean 'lease'?",
                "m.yaml:4:42: hub.zenoh.transport.link.tx.lease: zenoh refuses it: error parsing number",
            ],
        ),
        (
            "hub: {zenoh: {downsampling: [{rules: [{key_expr: 'x', frq: 2}]}]}}",
            [
                "m.yaml:1:55: hub.zenoh.downsampling[0].rules[0].frq: zenoh has no key 'frq' here; did you mean 'freq'?"
            ],
        ),
        (
            "hub: {zenoh: {access_control: {enabled: true, rules: [{id: x}]}}}",
            ["m.yaml:1:47: hub.zenoh.access_control.rules[0]: zenoh refuses it: missing field `key_exprs`"],
        ),
        (
            "zenoh: {zenoh: {listen: [tcp/127.0.0.1:7]}}",
            [
                'm.yaml:1:17: zenoh.zenoh.listen[0]: zenoh refuses it: invalid type: string "tcp/127.0.0.1:7", expected i64 or mode dependent i64'
            ],
        ),
        (
            "hub: {open: {zenoh: {'connect/endpoints': ['tcp/127.0.0.1:7']}}}",
            [
                "m.yaml:1:22: hub.open.zenoh.connect/endpoints: zenoh has no key 'connect/endpoints' here; did you mean 'connect'?"
            ],
        ),
        ("hub: {zenoh: {transport: null}}", ["m.yaml:1:15: hub.zenoh.transport: zenoh refuses it: invalid type: unit value, expected struct TransportConf"]),
    ],
)  # fmt: skip
def test_mistakes_that_zenohs_parser_refuses_are_located(text: str, lines: list[str]) -> None:
    assert problems(text) == lines


@pytest.mark.parametrize("section", ["zenoh", "router_zenoh"])
@pytest.mark.parametrize(
    ("settings", "place", "text"),
    [
        ("transport: {link: {tx: {batch_size: 0}}}", "transport.link.tx.batch_size", "0 permits no message; leave it out"),
        ("transport: {link: {tx: {batch_size: 8}}}", "transport.link.tx.batch_size", "8 permits no message; leave it out"),
        ("transport: {link: {rx: {max_message_size: 10}}}", "transport.link.rx.max_message_size", "10 permits no message; leave it out"),
        ("transport: {link: {tx: {lease: 3}}}", "transport.link.tx.lease", "3 ms would end links again and again; set at least 500, or leave it out"),
        ("transport: {unicast: {accept_timeout: 0}}", "transport.unicast.accept_timeout", "0 permits no link; leave it out"),
        ("transport: {unicast: {max_sessions: 2}}", "transport.unicast.max_sessions", "2 sessions are too few for the workers and commands; set at least 16"),
        ("transport: {link: {tx: {keep_alive: 0}}}", "transport.link.tx.keep_alive", "0 permits no link; leave it out"),
        ("transport: {unicast: {accept_pending: 0}}", "transport.unicast.accept_pending", "0 permits no link; leave it out"),
        ("transport: {unicast: {max_sessions: 0}}", "transport.unicast.max_sessions", "0 permits no link; leave it out"),
        ("transport: {unicast: {open_timeout: 0}}", "transport.unicast.open_timeout", "0 permits no link; leave it out"),
        ("scouting: {gossip: {enabled: false}}", "scouting.gossip.enabled", "workers would not find each other; leave it out"),
        (f"access_control: {{enabled: true, default_permission: deny, {NO_RULES}}}", "access_control", ALLOWS_NOTHING),
        (f"access_control: {{enabled: true, {NO_RULES}}}", "access_control", ALLOWS_NOTHING),
        (f"access_control: {{enabled: true, rules: [{RULE}], subjects: [{{id: s}}], policies: []}}", "access_control", ALLOWS_NOTHING),
        ("transport: {link: {protocols: [udp]}}", "transport.link.protocols", "must contain 'tcp', the protocol of 'hub.listen'"),
        ("transport: {link: {protocols: []}}", "transport.link.protocols", "must contain 'tcp', the protocol of 'hub.listen'"),
        ("namespace: robot1", "namespace", "workers and commands would not find each other; 'hub.domain' separates hubs"),
    ],
)  # fmt: skip
def test_settings_with_which_nothing_would_work_are_refused(section: str, settings: str, place: str, text: str) -> None:
    (line,) = problems(f"hub: {{{section}: {{{settings}}}}}")
    assert line.endswith(f": hub.{section}.{place}: {text}")


APART = "workers would not connect to each other without '{}' in this list; leave it out"
HOPS = "workers would not find each other unless 'hub.router_zenoh' has it, too; leave it out"


@pytest.mark.parametrize(
    ("section", "gossip", "key", "text"),
    [
        ("zenoh", "autoconnect: []", "autoconnect", APART.format("peer")),
        ("zenoh", "autoconnect: {peer: [router]}", "autoconnect", APART.format("peer")),
        ("zenoh", "target: []", "target", APART.format("router")),
        ("zenoh", "target: {peer: [peer]}", "target", APART.format("router")),
        ("zenoh", "multihop: true", "multihop", HOPS),
        ("router_zenoh", "target: []", "target", APART.format("peer")),
        ("router_zenoh", "target: {router: [router]}", "target", APART.format("peer")),
    ],
)
@pytest.mark.parametrize("inline", [True, False])
def test_gossip_that_keeps_workers_apart_is_refused(
    section: str, gossip: str, key: str, text: str, inline: bool, tmp_path: Path
) -> None:
    settings = f"{{scouting: {{gossip: {{{gossip}}}}}}}"
    (file := tmp_path / "zenoh.yaml").write_text(settings)
    (line,) = problems(f"hub: {{{section}: {settings if inline else file}}}")
    assert line.endswith(f": hub.{section}.scouting.gossip.{key}: {text}")


def test_gossip_may_be_off_if_the_workers_in_a_file_are_clients(tmp_path: Path) -> None:
    (file := tmp_path / "zenoh.json5").write_text("{mode: 'client'}")
    assert loads(f"hub: {{zenoh: {file}, router_zenoh: {{scouting: {{gossip: {{enabled: false}}}}}}}}")


WORKERS_APART = "the workers would not reach the daemon's router, because the list replaces Midspan's; add 'tcp/127.0.0.1:7447' (hub.listen), or set 'hub.router: false' if this daemon has no router"
ROUTER_APART = "workers and commands would not reach the router, because the list replaces Midspan's; add 'tcp/127.0.0.1:7447' (hub.listen)"
MACHINES_APART = "other machines would not reach this machine's programs, because the list replaces Midspan's; add 'tcp/127.0.0.1:7447' (hub.listen)"


@pytest.mark.parametrize(
    ("hub", "place", "text"),
    [
        ("zenoh: {connect: {endpoints: ['tcp/127.0.0.1:7448']}}", "zenoh.connect", WORKERS_APART),
        ("zenoh: {connect: {endpoints: ['tcp/robot:7447', 'tcp/[::1]:7447', 'udp/127.0.0.1:7447']}}", "zenoh.connect", WORKERS_APART),
        ("zenoh: {connect: {endpoints: []}}", "zenoh.connect", WORKERS_APART),
        ("zenoh: {connect: {endpoints: {client: ['tcp/127.0.0.1:7447']}}}", "zenoh.connect", WORKERS_APART),
        ("zenoh: {mode: client, connect: {endpoints: ['tcp/robot:7447']}}", "zenoh.connect", WORKERS_APART),
        ("zenoh: {listen: {endpoints: []}}", "zenoh.listen", "workers would not connect to each other; leave it out"),
        ("router_zenoh: {listen: {endpoints: ['tcp/127.0.0.1:7448']}}", "router_zenoh.listen", ROUTER_APART),
        ("router_zenoh: {listen: {endpoints: {peer: ['tcp/127.0.0.1:7447']}}}", "router_zenoh.listen", ROUTER_APART),
        ("open: {zenoh: {connect: {endpoints: ['tls/robot:7448']}}}", "open.zenoh.connect", MACHINES_APART),
    ],
)  # fmt: skip
def test_endpoints_without_that_of_the_hub_are_refused(hub: str, place: str, text: str) -> None:
    (line,) = problems(f"hub: {{{hub}}}")
    assert line.endswith(f": hub.{place}.endpoints: {text}")


@pytest.mark.parametrize(
    "hub",
    [
        "zenoh: {connect: {endpoints: ['tcp/robot:7447', 'tcp/127.0.0.1:7447#so_sndbuf=65000']}}",
        "zenoh: {connect: {endpoints: {peer: ['tcp/localhost:7447']}}}",
        "router: false, zenoh: {mode: client, connect: {endpoints: ['tls/robot:7448']}}",
        "zenoh: {mode: client, listen: {endpoints: []}, scouting: {gossip: {enabled: false}}}",
        "zenoh: {mode: client}, router_zenoh: {scouting: {gossip: {enabled: false}}}",
        "zenoh: {connect: {endpoints: []}, scouting: {gossip: {enabled: false}, multicast: {enabled: true}}}",
        "router: false, zenoh: {scouting: {gossip: {multihop: true}}}",
        "zenoh: {scouting: {gossip: {autoconnect: []}, multicast: {enabled: true}}}",
        "zenoh: {mode: client, scouting: {gossip: {autoconnect: [], target: [], multihop: true}}}",
        "listen: 'unixsock-stream//tmp/a', zenoh: {connect: {endpoints: ['unixsock-stream//tmp/a']}}",
        "router_zenoh: {listen: {endpoints: ['tcp/localhost:7447', 'tcp/127.0.0.1:7450']}}",
    ],
)
def test_endpoints_with_that_of_the_hub_are_accepted(hub: str) -> None:
    assert loads(f"hub: {{{hub}}}").hub


def test_zenohs_defaults_in_a_file_are_accepted(tmp_path: Path) -> None:
    (tmp_path / "zenoh.json5").write_text("{connect: {endpoints: []}, scouting: {gossip: {enabled: true}}}")
    assert loads("hub: {zenoh: zenoh.json5}", tmp_path / "m.yaml").hub.zenoh == tmp_path / "zenoh.json5"


@pytest.mark.parametrize(
    ("listen", "protocols"), [("tcp/127.0.0.1:7447", ["tcp", "udp"]), ("tls/127.0.0.1:7447", ["tls"])]
)
def test_zenohs_link_protocols_may_contain_that_of_the_hub(listen: str, protocols: list[str]) -> None:
    config = loads(json.dumps({"hub": {"listen": listen, "zenoh": {"transport": {"link": {"protocols": protocols}}}}}))
    assert config.hub.listen == listen


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        (
            "hub: {zenoh: {connect: {retry: {period_init: 3}}}}",
            ["m.yaml:1:33: hub.zenoh.connect.retry.period_init: zenoh has no key 'period_init' here; did you mean 'period_init_ms'?"],
        ),
        (
            "hub: {zenoh: {qos: {publication: [{key_exprs: [a], config: {priorty: data}}]}}}",
            ["m.yaml:1:61: hub.zenoh.qos.publication[0].config.priorty: zenoh has no key 'priorty' here; did you mean 'priority'?"],
        ),
        (
            "hub: {zenoh: {scouting: {gossip: {autoconnect_strategy: {peer: {to_rooter: always}}}}}}",
            ["m.yaml:1:58: hub.zenoh.scouting.gossip.autoconnect_strategy.peer: zenoh ignores it; check the spelling of all its keys"],
        ),
        (
            "hub: {zenoh: {transport: {link: {tx: {lease: -1}}}}}",
            ["m.yaml:1:39: hub.zenoh.transport.link.tx.lease: zenoh reads -1 as 0; the value is out of range"],
        ),
        (
            "hub: {zenoh: {connect: {endpoints: ['tpc/robot:7447', 'tcp/robot', 'tcp/robot:7447']}}}",
            [
                f"m.yaml:1:25: hub.zenoh.connect.endpoints[0]: tpc/robot:7447: 'tpc' is not one of {PROTOCOLS}; did you mean 'tcp'?",
                "m.yaml:1:25: hub.zenoh.connect.endpoints[1]: 'tcp/robot' has no port from 0 to 65535; write it like tcp/robot:7447",
            ],
        ),
        (
            "hub: {router_zenoh: {listen: {endpoints: {router: ['tcp/0.0.0.0:7447']}}}}",
            ["m.yaml:1:43: hub.router_zenoh.listen.endpoints.router[0]: tcp/0.0.0.0:7447 is open to other machines, which may join only through hub.open"],
        ),
        (
            "hub: {zenoh: {id: abc123}}",
            ["m.yaml:1:15: hub.zenoh.id: all sessions would have this id, and only one could join; leave it out"],
        ),
        (
            "hub: {zenoh: {transport: [], scouting: {gossip: [true]}}}",
            [
                "m.yaml:1:15: hub.zenoh.transport: must be a map, not a list",
                "m.yaml:1:41: hub.zenoh.scouting.gossip: must be a map, not a list",
            ],
        ),
        (
            "hub: {zenoh: {listen: {endpoints: ['serial//dev/ttyUSB0']}}}",
            [f"m.yaml:1:24: hub.zenoh.listen.endpoints[0]: serial//dev/ttyUSB0: 'serial' is not one of {PROTOCOLS}"],
        ),
        (
            f"hub: {{router_zenoh: {{access_control: {{enabled: true, rules: [{RULE}, {RULE}], subjects: [{{id: s}}], policies: [{{rules: [r, q], subjects: [s]}}]}}}}}}",
            [
                "m.yaml:1:142: hub.router_zenoh.access_control.rules[1].id: 'r' is also the id of an earlier item; give each item its own",
                "m.yaml:1:254: hub.router_zenoh.access_control.policies[0].rules: no rule has the id 'q'",
            ],
        ),
        (
            "hub: {zenoh: {access_control: {enabled: true, rules: []}}}",
            ["m.yaml:1:15: hub.zenoh.access_control: has no subjects and no policies; zenoh needs all three lists"],
        ),
        (
            "hub: {zenoh: {transport: {unicast: {lowlatency: true}}}}",
            ["m.yaml:1:37: hub.zenoh.transport.unicast.lowlatency: zenoh also needs 'qos: {enabled: false}' in this section"],
        ),
        (
            "hub: {router_zenoh: {mode: peer}}",
            ["m.yaml:1:22: hub.router_zenoh.mode: the mode of the daemon's router is 'router', not 'peer'; leave it out"],
        ),
        (
            "zenoh: {zenoh: {transport: {link: {tls: {root_ca_certificate: /no/ca.pem}}}}}",
            ["m.yaml:1:42: zenoh.zenoh.transport.link.tls.root_ca_certificate: no such file: /no/ca.pem"],
        ),
        (
            "hub: {zenoh: {transport: {auth: {usrpwd: {user: a, password: b, dictionary_file: /etc}}}}}",
            ["m.yaml:1:65: hub.zenoh.transport.auth.usrpwd.dictionary_file: /etc is a folder, not a file"],
        ),
        (
            "hub: {zenoh: {scouting: {multicast: {enabled: true, ttl: 400}}}}",
            ["m.yaml:1:53: hub.zenoh.scouting.multicast.ttl: 400 is not from 0 to 255"],
        ),
        (
            "hub: {zenoh: {connect: {endpoints: ['tcp//robot:7447']}}}",
            ["m.yaml:1:25: hub.zenoh.connect.endpoints[0]: 'tcp//robot:7447' has no valid address; write it like tcp/robot1:7447 or tcp/[::1]:7447"],
        ),
        (
            "zenoh: {dialects: [{dialect: ros1}, {dialect: ros2dds}], zenoh: {listen: {endpoints: ['tcp/127.0.0.1:7450', 'tcp/[::1]:0']}}}",
            ["m.yaml:1:75: zenoh.zenoh.listen.endpoints[0]: only one of the 2 dialects could listen at tcp/127.0.0.1:7450; use port 0, or connect to a router"],
        ),
        (
            "zenoh: {zenoh: {mode: client}}",
            ["m.yaml:1:17: zenoh.zenoh.mode: a client needs the address of its router: set zenoh.router, or 'connect: {endpoints: [...]}'"],
        ),
    ],
)  # fmt: skip
def test_mistakes_that_zenohs_parser_accepts_are_located(text: str, lines: list[str]) -> None:
    assert problems(text) == lines


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"a:b\n\n  c : d \n", ""),
        (b"a:b:c\n", ""),
        (b"a:b\nsecret\n", "line 2 is not 'user:password'"),
        (b"a:\n", "line 1 is not 'user:password'"),
        (b"a:b\n:b\n", "line 2 is not 'user:password'"),
        (b"# users\n", "line 1 is not 'user:password'"),
        (b"\xff:b\n", "is not a text in UTF-8"),
    ],
)
def test_a_dictionary_of_users_is_refused_if_zenoh_refuses_it(tmp_path: Path, content: bytes, problem: str) -> None:
    file = tmp_path / "users.txt"
    file.write_bytes(content)
    users = {"user": "a", "password": "b", "dictionary_file": str(file)}
    settings = {"scouting": {"multicast": {"enabled": False}}, "transport": {"auth": {"usrpwd": users}}}
    text, config = json.dumps({"hub": {"zenoh": settings}}), zenoh.Config.from_json5(json.dumps(settings))
    with pytest.raises(zenoh.ZError) if problem else nullcontext():
        zenoh.open(config).close()
    with pytest.raises(ConfigError, match=f"{file}.*{problem}") if problem else nullcontext():
        loads(text, tmp_path / "m.yaml")


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("hub: {listen: tpc/127.0.0.1:7447}", "1:15: hub.listen: "),
        ("hub: {open: {listen: ['tpc/0.0.0.0:7448'], insecure: true}}", "1:23: hub.open.listen[0]: "),
        ("hub: {open: {connect: 'tpc/robot1:7448', insecure: true}}", "1:23: hub.open.connect: "),
        ("zenoh: {router: tpc/robot1:7447}", "1:17: zenoh.router: "),
    ],
)
def test_an_unknown_protocol_is_refused_in_every_endpoint(text: str, place: str) -> None:
    (problem,) = problems(text)
    assert problem.startswith(f"m.yaml:{place}tpc/")
    assert problem.endswith(f"'tpc' is not one of {PROTOCOLS}; did you mean 'tcp'?")


@pytest.mark.parametrize(
    "text",
    [
        "zenoh: {router: tcp/robot:7447, zenoh: {mode: client}}",
        "zenoh: {zenoh: {mode: client, connect: {endpoints: {client: [tcp/robot:7447]}}}}",
        "zenoh: {zenoh: {mode: client, scouting: {multicast: {enabled: true}}}}",
    ],
)
def test_a_client_that_can_find_its_router_is_accepted(text: str) -> None:
    assert loads(text).zenoh.zenoh


@pytest.mark.parametrize(
    ("text", "cures"),
    [
        (
            "zenoh: {zenoh: {plugins: {ros2dds: {namespace: /bot, domain: 5, allow: {publishers: ['.*']}}}}}",
            ["'zenoh: {dialects: [{dialect: ros2dds, namespace: /bot}]}'", "'ros2: {domain: 5}'", "and replace its allow by rules with 'from: zenoh_ros2dds'"],
        ),
        (
            "hub: {zenoh: {plugins: {ros1: {bridge_namespace: bot, ros_master_uri: 'http://robot:11311'}}}}",
            ["'zenoh: {dialects: [{dialect: ros1, namespace: bot}]}'", "'ros1: {master: \"http://robot:11311\"}'"],
        ),
        ("hub: {zenoh: {plugins: {dds: {domain: 0}}}}", ["run zenoh-bridge-ros2dds on the robot", "{dialect: ros2dds}"]),
        ("hub: {router_zenoh: {plugins: {rest: {http_port: 8000}}}}", ["run zenohd with 'rest', connect it to hub.listen"]),
    ],
)  # fmt: skip
def test_settings_of_a_bridge_are_refused_with_what_to_write_instead(text: str, cures: list[str]) -> None:
    (problem,) = problems(text)
    assert ".plugins." in problem
    assert [cure for cure in cures if cure not in problem] == []


FILES = {
    "comma.json5": ('{ mode: "peer" connect: }', ["1:9: hub.zenoh: not valid JSON5: expected boolean or null; check commas, quotes and brackets from here on"]),
    "closed.json5": ('{mode: "peer"}, "plugins": {}', ["1:15: hub.zenoh: not valid JSON5: expected EOI; check commas, quotes and brackets from here on"]),
    "deep.json5": ("{a:" * 5000 + "1" + "}" * 5000, [" hub.zenoh: has more than 100 nested brackets"]),
    "list.json5": ("[]", [" hub.zenoh: must be a map, for example {mode: client}"]),
    "key.json5": (
        '{ // of the robot\n  mode: "client",\n  "connect": {\n    endpoints: ["tcp/10.0.0.1:7447"],\n    retyr: 3,\n  },\n}\n// end',
        ["5:5: hub.zenoh.connect.retyr: zenoh has no key 'retyr' here; did you mean 'retry'?"],
    ),
    "ignored.json5": (
        "{connect: {retry: {period: 3}}}",
        ["1:20: hub.zenoh.connect.retry.period: zenoh has no key 'period' here; did you mean 'period_max_ms'?"],
    ),
    "key.yaml": (
        "mode: peer\ntransport:\n  link:\n    tx: {leese: 3}\n",
        ["4:10: hub.zenoh.transport.link.tx.leese: zenoh has no key 'leese' here; did you mean 'lease'?"],
    ),
    "zenoh.conf": ("{}", [" hub.zenoh: zenoh cannot read the file: Unsupported file type '.conf' (.json, .json5 and .yaml are supported)"]),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_problems_in_a_file_of_zenohs_settings_have_its_lines(tmp_path: Path, name: str) -> None:
    text, lines = FILES[name]
    (tmp_path / name).write_text(text)
    assert problems(f"hub: {{zenoh: {name}}}", tmp_path / "m.yaml") == [f"{tmp_path / name}:{line}" for line in lines]


def test_plugins_in_the_file_of_a_bridge_are_refused_with_midspans_setting(tmp_path: Path) -> None:
    (tmp_path / "bridge.json5").write_text('{\n  mod: "peer",\n  plugins: {ros2dds: {namespace: "/bot"}}\n}')
    key, plugin = problems("zenoh: {zenoh: bridge.json5}", tmp_path / "m.yaml")
    assert key.startswith(f"{tmp_path / 'bridge.json5'}:2:3: zenoh.zenoh.mod: ")
    assert plugin.startswith(
        f"{tmp_path / 'bridge.json5'}:3:13: zenoh.zenoh.plugins.ros2dds: is for zenoh-bridge-ros2dds"
    )
    assert "write 'zenoh: {dialects: [{dialect: ros2dds, namespace: /bot}]}' in Midspan's file" in plugin


def test_config_check_prints_the_problem(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "m.yaml"
    file.write_text("hub:\n  zenoh: {transport: {link: {tx: {leese: 3000}}}}\n")
    assert main(["config", "check", str(file)]) == 1
    problem = "hub.zenoh.transport.link.tx.leese: zenoh has no key 'leese' here; did you mean 'lease'?"
    assert capsys.readouterr().err == f"{file}:2:35: {problem}\n"


def test_a_file_that_is_broken_later_is_refused_at_the_next_load(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text("hub: {router_zenoh: router.json5}")
    (tmp_path / "router.json5").write_text("{transport: {unicast: {max_sessions: 2000}}}")
    load(tmp_path / "m.yaml")
    (tmp_path / "router.json5").write_text("{transport: {unicast: {max_session: 2000}}}")
    with pytest.raises(ConfigError, match="did you mean 'max_sessions'"):
        load(tmp_path / "m.yaml")


@pytest.mark.parametrize(
    "text",
    [
        "{mode: client, connect: {endpoints: {client: ['tls/robot:7448'], peer: []}, timeout_ms: {client: 100}}}",
        "{transport: {link: {tls: {root_ca_certificate_base64: eA==}}, auth: {usrpwd: {user: a, password: b}}}}",
        "{routing: {peer: {mode: peer_to_peer}, router: {peers_failover_brokering: true}}}",
        f"{{access_control: {{enabled: true, rules: [{RULE}], subjects: [{{id: s}}], policies: [{{rules: [r], subjects: [s]}}]}}}}",
        "{metadata: {any: thing}, plugins: {}, queries_default_timeout: 5000.0}",
        "{scouting: {multicast: {autoconnect: {peer: [router]}, autoconnect_strategy: {peer: {to_router: always}}}}}",
    ],
)
def test_valid_settings_are_accepted(text: str) -> None:
    assert loads(f"hub: {{router: false, zenoh: {text}}}").hub.zenoh


def test_the_stock_file_of_another_program_is_accepted() -> None:
    import zenoh_ros2_sdk

    folder = Path(zenoh_ros2_sdk.__file__).parent / "config"
    assert loads(f"hub: {{zenoh: '{folder / 'default_session_config.json5'}'}}").hub.zenoh
