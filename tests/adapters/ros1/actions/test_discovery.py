"""Actions are derived from the master's state."""

import pytest

from bridge.adapters.ros1.actions import discovery
from bridge.adapters.ros1.actions.discovery import FROM_SERVER, TO_SERVER, FoundServer, find, is_native, topics_of
from bridge.adapters.ros1.graph.probe import Facts
from bridge.adapters.ros1.graph.state import MasterState, Registration
from bridge.messages import actions as ros2_action

OWN = "/midspan"
MOVE = topics_of("/move_base", "move_base_msgs/MoveBase")
SERVER = FoundServer("/move_base", "move_base_msgs/MoveBase", "/planner", "http://planner:1/")


def links(node, name, names):
    return {Registration(node, f"{name}/{part}", f"http:/{node}:1/") for part in names}


def master_state(*, servers=(), clients=(), types=MOVE):
    """Return a master's state with servers and clients, given as pairs of a node and an action."""
    published = set().union(
        *(links(n, a, FROM_SERVER) for n, a in servers), *(links(n, a, TO_SERVER) for n, a in clients)
    )
    subscribed = set().union(
        *(links(n, a, TO_SERVER) for n, a in servers), *(links(n, a, FROM_SERVER) for n, a in clients)
    )
    return MasterState("run", "net", frozenset(published), frozenset(subscribed), types=types)


def test_a_server_is_found_by_its_topics():
    result = find(master_state(servers=[("/planner", "/move_base")]), OWN)
    assert result.servers == {"/move_base": (SERVER,)}
    assert result.topics == MOVE


def test_endpoints_of_this_node_do_not_count():
    assert not find(master_state(servers=[(OWN, "/move_base")], clients=[(OWN, "/move_base")]), OWN).topics


def test_a_client_without_server_has_only_topics():
    result = find(master_state(clients=[("/rviz", "/move_base")]), OWN)
    assert (result.servers, result.topics) == ({}, MOVE)


def test_two_servers_are_ordered_by_name():
    result = find(master_state(servers=[("/b", "/move_base"), ("/a", "/move_base")]), OWN)
    assert [s.node for s in result.servers["/move_base"]] == ["/a", "/b"]


@pytest.mark.parametrize("lacking", sorted(FROM_SERVER | TO_SERVER))
def test_four_topics_are_not_an_action(lacking):
    whole = master_state(servers=[("/planner", "/move_base")])
    topic = f"/move_base/{lacking}"
    less = MasterState(
        "run", "net", frozenset(p for p in whole.publishers if p.topic != topic),
        frozenset(s for s in whole.subscribers if s.topic != topic), types=MOVE,
    )  # fmt: skip
    assert not find(less, OWN).topics


@pytest.mark.parametrize("topic", sorted(MOVE))
def test_inconsistent_types_are_not_an_action(topic):
    other = find(master_state(servers=[("/planner", "/move_base")], types={**MOVE, topic: "std_msgs/String"}), OWN)
    assert not other.topics
    unknown = find(master_state(servers=[("/planner", "/move_base")], types={**MOVE, topic: "*"}), OWN)
    assert bool(unknown.topics) == (topic != "/move_base/result"), "only the result names the type"


def test_topics_of_several_nodes_are_not_a_server():
    publishers = links("/a", "/move_base", FROM_SERVER)
    assert not find(
        MasterState("run", "net", frozenset(publishers), frozenset(links("/b", "/move_base", TO_SERVER))), OWN
    ).topics


def facts(*, native=True):
    return Facts("t", "m", "", latching=False, native=native)


def test_the_origin_of_a_server_is_known_once_it_has_responded():
    known = {SERVER.link(part): facts() for part in FROM_SERVER}
    assert is_native(SERVER, known) is True
    assert is_native(SERVER, {**known, SERVER.link("result"): facts(native=False)}) is False
    del known[SERVER.link("status")]
    assert is_native(SERVER, known) is None


@pytest.mark.parametrize("part", [*ros2_action.SERVICES, *ros2_action.TOPICS])
def test_only_names_and_types_of_an_actions_parts_are_recognized_as_parts(part):
    name, type_name = ros2_action.part_name("/a/b", part), discovery.part_type("move_base_msgs/MoveBase", part)
    assert discovery.split_part(name, type_name) == ("/a/b", part)
    assert discovery.split_part(name, "std_msgs/String") is None
    assert discovery.split_part(f"/_action/{part}"[1:], type_name) is None
    assert discovery.split_part("/a/b/other", type_name) is None
    if part not in (ros2_action.CANCEL_GOAL, ros2_action.STATUS):
        assert discovery.action_type(type_name, part) == "move_base_msgs/MoveBase"
