"""The host of modules, with a module of the tests' own."""
