"""SIGHUP: the new file is checked first, and then only the workers that use a change reload."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path

import pytest

from bridge.config.model import Config
from bridge.daemon.query import ask_daemon, reload_daemon
from bridge.hub.security.certificates import Authority
from tests.peers.daemon.daemon import Daemon, alive
from tests.support.process import Process
from tests.support.wait import until

WORKERS = ("router", "ros1", "ros2")
MANY = 8  #: cores: all workers start at once


def reload(daemon: Daemon, process: Process, config: str) -> None:
    daemon.configure(config)
    process.signal(signal.SIGHUP)


def phases(daemon: Daemon) -> dict[str, str]:
    """Return the workers' phases, by name."""
    status = ask_daemon(Config(name="test", state=daemon.folder / "state"), 20.0)
    return {} if status is None else {report.worker: report.phase for report in status.workers}


def test_only_workers_that_use_the_change_reload(daemon: Daemon) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    reload(daemon, process, "routing: {default: deny}\n")
    sides = ("ros1", "ros2")
    until(lambda: all(daemon.events(worker, "reload") for worker in sides), "both sides reload")
    assert [daemon.events(worker, "reload") for worker in sides] == [[["reload", "deny"]]] * 2
    until(lambda: process.output().count("ready: ") == 2, "the daemon is ready again")
    assert daemon.events("router", "reload") == []
    assert [len(daemon.pids(worker)) for worker in WORKERS] == [1, 1, 1]


def test_a_change_of_one_side_does_not_reload_the_other(daemon: Daemon) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    reload(daemon, process, "ros1: {poll: 1}\n")
    until(lambda: daemon.events("ros1", "reload"), "ros1 reloads")
    until(lambda: process.output().count("ready: ") == 2, "the daemon is ready again")
    assert daemon.events("ros2", "reload") == []


def test_an_unchanged_file_reloads_no_worker(daemon: Daemon) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    process.signal(signal.SIGHUP)
    until(lambda: process.output().count("ready: ") == 2, "the daemon is ready again")
    assert [daemon.events(worker, "reload") for worker in WORKERS] == [[], [], []]


def test_only_the_worker_that_needs_a_restart_is_restarted(daemon: Daemon) -> None:
    daemon.order("ros1", "refuse-reload")
    process = daemon.start()
    daemon.wait_ready(process)
    reload(daemon, process, "routing: {default: deny}\n")
    assert alive(daemon.wait_started("ros1", 2))
    assert daemon.events("ros1", "start")[1][2] == "deny"
    assert len(daemon.events("ros1", "stop")) == 1
    until(lambda: process.output().count("ready: ") == 2, "the daemon is ready again")
    assert len(daemon.pids("ros2")) == len(daemon.pids("router")) == 1


def test_workers_that_restart_stop_in_order_before_any_starts(daemon: Daemon) -> None:
    """A canceled goal and a zero velocity of the modules still reach the robot through the sides."""
    workers = ("router", "ros1", "ros2", "sim")
    for worker in workers:
        daemon.order(worker, "refuse-reload")
    daemon.order("sim", "refuse-reload", "wait-at-stop")
    daemon.configure("sim: {enabled: true}\n")
    process = daemon.quick(MANY, stop=60.0, apply=60.0)
    daemon.wait_ready(process)
    reload(daemon, process, "sim: {enabled: true}\nlog: {level: debug}\n")
    until(lambda: daemon.events("sim", "stop"), "the simulator stops")
    until(lambda: phases(daemon).get("sim") == "stopping", "the daemon reports it")
    assert phases(daemon)["ros1"] == "running", "a side runs until the simulator has stopped"
    assert [daemon.events(worker, "reload") for worker in WORKERS] == [[], [], []]
    daemon.order("sim", "refuse-reload")
    until(lambda: process.output().count("ready: ") == 2, "the daemon is ready again")
    reloaded = process.output().partition("configuration reloaded")[2]
    steps = re.findall(r"stopping \w+|\w+ ended with exit code 0|\w+ started", reloaded)
    assert steps[:2] == ["stopping sim", "sim ended with exit code 0"]
    assert sorted(steps[2:6]) == [
        "ros1 ended with exit code 0",
        "ros2 ended with exit code 0",
        "stopping ros1",
        "stopping ros2",
    ]
    assert steps[6:8] == ["stopping router", "router ended with exit code 0"]
    assert steps[8] == "router started"
    assert sorted(steps[8:]) == [f"{worker} started" for worker in sorted(workers)]


def test_a_worker_that_does_not_apply_a_reload_delays_the_others_only_for_a_time(daemon: Daemon) -> None:
    daemon.order("sim", "compute-at-reload")
    daemon.configure("sim: {enabled: true}\n")
    process = daemon.quick(MANY, apply=0.5)
    daemon.wait_ready(process)
    reload(daemon, process, "sim: {enabled: true}\nlog: {level: debug}\n")
    until(lambda: daemon.events("sim", "reload"), "the simulator reloads")
    until(lambda: all(daemon.events(worker, "reload") for worker in WORKERS), "the others reload")
    assert process.output().count("ready: ") == 1
    daemon.order("sim")
    until(lambda: process.output().count("ready: ") == 2, "the daemon is ready again")


@pytest.mark.parametrize(
    ("config", "complaint"),
    [
        ("routing: {defaults: deny}\n", "midspan.yaml:3:11: routing.defaults: unknown key 'defaults'; did you mean"),
        ("routing: [\n", "midspan.yaml:4:1: not valid YAML"),
        ("hub: {domain: 999}\n", "midspan.yaml:3:15: hub.domain"),
        (f"types: {{folders: [/{'a' * 300}]}}\n", "midspan.yaml:3:19: types.folders[0]: cannot read /aaa"),
        (
            "hub: {zenoh: {transport: {link: {tx: {leese: 9}}}}}\n",
            "hub.zenoh.transport.link.tx.leese: zenoh has no key",
        ),
    ],
)
def test_broken_file_keeps_the_running_configuration(daemon: Daemon, config: str, complaint: str) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    reload(daemon, process, config)
    daemon.expect_output(process, complaint)
    daemon.expect_output(process, "reload refused, the running configuration is kept")
    assert [daemon.events(worker, "reload") for worker in WORKERS] == [[], [], []]
    reload(daemon, process, "routing: {default: deny}\n")
    until(lambda: daemon.events("ros1", "reload"), "the corrected file is loaded")


PROFILE = (
    '<dds><profiles><participant profile_name="p" is_default_profile="true"><rtps><name>old</name></rtps>'
    "</participant></profiles></dds>"
)


def test_a_changed_file_that_the_configuration_names_counts_as_a_change(daemon: Daemon) -> None:
    (profile := daemon.folder / "profile.xml").write_text(PROFILE)
    daemon.configure("ros2: {profile: profile.xml}\n")
    process = daemon.start()
    daemon.wait_ready(process)
    profile.write_text(PROFILE.removesuffix("</dds>"))
    process.signal(signal.SIGHUP)
    daemon.expect_output(process, f"midspan.yaml:3:17: ros2.profile: {profile} is not XML: ")
    assert daemon.events("ros2", "reload") == []
    profile.write_text(PROFILE.replace("old", "new"))
    process.signal(signal.SIGHUP)
    until(lambda: daemon.events("ros2", "reload"), "the side reloads")
    until(lambda: process.output().count("ready: ") == 3, "the daemon is ready again")
    assert daemon.events("ros1", "reload") == daemon.events("router", "reload") == []


def test_a_changed_file_that_cannot_be_used_changes_nothing(daemon: Daemon) -> None:
    authority = Authority(daemon.folder / "keys")
    authority.make()
    authority.issue("robot1")
    ca, certificate, key = (str(daemon.folder / "keys" / name) for name in ("ca.pem", "robot1.pem", "robot1.key"))
    tls = {"root_ca_certificate": ca, "connect_certificate": certificate, "connect_private_key": key}
    settings = daemon.folder / "zenoh.json5"
    settings.write_text(json.dumps({"transport": {"link": {"tls": tls}}}))
    daemon.configure("hub: {zenoh: zenoh.json5}\n")
    process = daemon.start()
    daemon.wait_ready(process)
    Path(certificate).write_bytes(b"half of a file")
    process.signal(signal.SIGHUP)
    daemon.expect_output(process, f"hub: {certificate} is not a certificate (PEM)")
    Path(certificate).unlink()
    Path(certificate).symlink_to(certificate)
    process.signal(signal.SIGHUP)
    daemon.expect_output(process, f"hub: cannot read {certificate}: Too many levels of symbolic links")
    assert [daemon.events(worker, "reload") for worker in WORKERS] == [[], [], []]
    Path(certificate).unlink()
    authority.issue("robot1", replace=True)
    process.signal(signal.SIGHUP)
    until(lambda: all(daemon.events(worker, "reload") for worker in WORKERS), "all workers get the new certificate")


def test_name_cannot_change_while_running(daemon: Daemon) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    daemon.file.write_text("name: other\nstate: state\n")
    process.signal(signal.SIGHUP)
    rejection = "name: changing it from 'test' to 'other' needs a restart of the daemon"
    daemon.expect_output(process, rejection)
    config = Config(name="test", state=daemon.folder / "state")
    assert rejection in (reload_daemon(config) or "")
    daemon.configure("ros1: {poll: 1}\n")
    assert reload_daemon(config) == ""
    until(lambda: daemon.events("ros1", "reload"), "a request reloads like the signal")
    assert reload_daemon(config.model_copy(update={"name": "other"})) is None
    assert all(alive(daemon.wait_started(worker)) for worker in WORKERS)


def test_sides_are_switched_off_and_on(daemon: Daemon) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    first = daemon.wait_started("ros1")
    reload(daemon, process, "ros1: {enabled: false}\n")
    until(lambda: not alive(first), "the disabled worker has exited")
    until(lambda: process.output().count("ready: ") == 2, "the daemon is ready again")
    assert len(daemon.events("ros1", "stop")) == 1
    reload(daemon, process, "")
    assert alive(daemon.wait_started("ros1", 2))


def test_a_reload_starts_a_worker_that_could_not_work(daemon: Daemon) -> None:
    daemon.order("ros1", "never")
    process = daemon.start()
    daemon.wait_ready(process)
    daemon.order("ros1")
    reload(daemon, process, "ros1: {poll: 1}\n")
    daemon.expect_output(process, "ros1: running")


def test_a_restarting_worker_gets_the_new_configuration(daemon: Daemon) -> None:
    daemon.order("ros1", "crash")
    process = daemon.start()
    daemon.wait_started("ros1", 2)
    reload(daemon, process, "routing: {default: deny}\n")
    until(lambda: daemon.events("ros1", "start")[-1][2] == "deny", "the worker is started with the new configuration")
