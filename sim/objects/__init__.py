"""The objects of the simulated world: embedded, suites, imported, and where they stand."""
