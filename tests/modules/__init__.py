"""The host of modules, with a module for the tests."""
