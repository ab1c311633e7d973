"""What can go wrong with names.

NamingError (an OSError)
  NoNameServerError     no name server where it should be, or it does not answer in time
  NameRefusedError      the name server answered, and did not take the name
  PortError             a port does not exist, does not answer, or does not do what it is asked
  ConfigError           the file that says where the name server is, cannot be used
"""

from __future__ import annotations


class NamingError(OSError):
    """A name could not be asked for or registered."""


class NoNameServerError(NamingError):
    """No name server answers where the configuration says it is."""


class NameRefusedError(NamingError):
    """The name server did not take a name."""


class ConfigError(NamingError):
    """The file that says where the name server is, is missing what it needs."""


class PortError(NamingError):
    """A port does not exist, does not answer, or does not do what it is asked."""
