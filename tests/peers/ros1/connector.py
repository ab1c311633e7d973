"""Counts the attempts of rospy to connect to publishers. Runs on the system's Python, without Midspan."""

from rospy.impl.registration import RegManager

from tests.peers.commands import Record


class Connector:
    """Counts the attempts of rospy to connect to the publishers that the master reports, by topic."""

    def __init__(self) -> None:
        self._attempts = Record()
        connect = RegManager._connect_topic_thread

        def connect_and_record(manager, topic, uri) -> None:
            connect(manager, topic, uri)
            self._attempts.add(topic)

        RegManager._connect_topic_thread = connect_and_record

    def attempts(self, topic):
        """Return how often rospy has tried to connect to a publisher of a topic."""
        return self._attempts.items.count(topic)
