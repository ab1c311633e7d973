"""The endpoints of a session on the hub: publishers, subscriptions, servers, clients and plain keys."""
