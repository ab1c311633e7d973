"""The bytes and names of rmw_zenoh: keys, attachments and quality of service."""
