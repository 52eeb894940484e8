"""Suites of single-joint objects behind one interface: `sim.suites.catalogue`."""
