"""The tests: a package of its own, so that no package named tests that a dependency installs is imported instead."""
