"""The sections of the configuration, one file each; ``bridge.config.model`` puts them together."""
