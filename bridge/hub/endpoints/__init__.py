"""What a session makes on the hub: publishers, subscriptions, servers, clients and plain keys."""
