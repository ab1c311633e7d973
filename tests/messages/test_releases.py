"""The releases to which a definition of a type belongs."""

from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_typestore

from bridge.messages import releases
from bridge.messages.releases import Release, by_hash, common, release_text

TYPES = (
    "lifecycle_msgs/msg/TransitionEvent",
    "nav_msgs/msg/Goals",
    "nav_msgs/msg/Trajectory",
    "rosgraph_msgs/msg/Graph",
    "std_msgs/msg/String",
)


@pytest.mark.parametrize("release", [release for release in Release if release is not Release.HUMBLE])
def test_the_hashes_of_each_releases_definitions_admit_that_release(release: Release) -> None:
    """The expected definitions are those of rosbags' type stores, which are independent of the table."""
    store = get_typestore(Stores[f"ROS2_{release.name}"])
    hashes = {name: store.hash_rihs01(name) for name in TYPES if name in store.fielddefs}
    assert hashes
    admitted = {name: by_hash(name, type_hash) for name, type_hash in hashes.items()}
    assert all(release in found for found in admitted.values()), admitted
    for other in set(Release) - {release, Release.HUMBLE}:
        differs = [n for n in TYPES if other not in admitted.get(n, releases.WITH_HASHES)]
        if Release.LYRICAL in (release, other):
            assert differs, "Lyrical differs from each earlier release"


@pytest.mark.parametrize(
    ("name", "type_hash", "text"),
    [
        ("nav_msgs/msg/Goals", "02305a51633b5c04d8979b878a7577cafd422f8a07465c878b17a920af3759e9", ""),
        (
            "nav2_msgs/action/NavigateThroughPoses_SendGoal",
            "5a590fa8e9a32b7b9c838fdf5939a2fb8858d6cfd25bdf2f2e5f0f7bbb25f52b",
            "Iron or Jazzy",
        ),
        (
            "nav2_msgs/action/NavigateThroughPoses_SendGoal",
            "0fb14135a40c3900a9a184f95b2ed6966a0ffd298739cc9de7903ebc6dc06a25",
            "Kilted or later",
        ),
        ("my_msgs/msg/Own", "0" * 64, ""),
        ("../msg/Own", "0" * 64, ""),
    ],
)
def test_hashes_of_navigation_types_give_their_releases(name: str, type_hash: str, text: str) -> None:
    admitted = by_hash(name, f"RIHS01_{type_hash}")
    assert release_text(admitted) == (text or release_text(releases.WITH_HASHES))


def test_a_node_with_several_announcements_has_their_common_releases() -> None:
    early = frozenset({Release.JAZZY, Release.KILTED})
    assert common([early, frozenset({Release.KILTED, Release.LYRICAL})]) == {Release.KILTED}
    assert common([]) == releases.ALL


@pytest.mark.parametrize(
    ("names", "text"),
    [
        ("", ""),
        ("HUMBLE", "Humble"),
        ("IRON JAZZY", "Iron or Jazzy"),
        ("IRON JAZZY KILTED", "Iron to Kilted"),
        ("JAZZY KILTED LYRICAL", "Jazzy or later"),
        ("LYRICAL", "Lyrical or later"),
        ("HUMBLE IRON JAZZY KILTED LYRICAL", ""),
    ],
)
def test_several_releases_are_described_in_words(names: str, text: str) -> None:
    assert release_text(frozenset(Release[name] for name in names.split())) == text
