"""The console's HTTP server: connections, logins, certificates and content."""
