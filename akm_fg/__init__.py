"""akm-fg: active kinematic modelling of articulated objects as a factor graph.

Importing this package is light; the rooms (`akm_fg.estimation`, `akm_fg.perception`,
`akm_fg.io`, ...) import what they need.
"""

__version__ = "0.1.0"
