"""Suites of single-joint objects behind one interface: `sim.objects.suites.catalogue`."""
