"""Real devices behind `Camera` and `Arm`: a RealSense, a Franka; and a check before they are used.

No physical robot was connected while this was written: docs/hardware.md says what was tried with
what.
"""
