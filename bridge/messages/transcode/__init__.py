"""Conversion of message bytes: types are compiled to programs, which a virtual machine runs."""
