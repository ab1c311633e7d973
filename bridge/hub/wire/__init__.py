"""The wire format of rmw_zenoh: keys, attachments and quality of service."""
