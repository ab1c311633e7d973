"""The client library: topics, services, actions, transforms, status, navigation and halt of a running Midspan.

A program outside of the daemon, on any machine that reaches the hub::

    from bridge.client.services import ServiceCaller
    from bridge.client.session import connect
    from bridge.client.status import ask_status
    from bridge.client.types import Types
    from bridge.config.load import load

    with connect(load()) as client:
        for document in ask_status(client):
            print(document.worker, document.state)
        lamp = ServiceCaller(client, Types(client), "/lamp")
        print(lamp.ask({"data": True}))

Errors are `bridge.client.errors.ClientError`. See docs/develop/client_library.md.
"""
