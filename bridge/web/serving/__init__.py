"""The console's HTTP server: connections, logins, certificates, and what it serves."""
