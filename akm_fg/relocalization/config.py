"""Tuning of relocalization."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from akm_fg.perception.surface.known_surface import KnownSurfaceConfig


@dataclass(frozen=True, slots=True)
class LikelihoodConfig:
    """How a depth image speaks for or against a state."""

    points: int = 500  # of the part's surface, spread; neighbours' errors agree beyond that
    static_points: int = 4000  # of what rests, that may hide the part
    # Shares of readings at points that should be seen: on the surface; before it (somebody stands
    # in the way); behind it (the part is not there, or depth is wrong at an edge).
    on: float = 0.80
    before: float = 0.17
    behind: float = 0.03
    depth_range_m: float = 1.0  # over which what is not on the surface may lie
    model_m: float = 0.003  # of the surface and its joint, beyond the reading's noise
    off_sigmas: float = 3.0  # beyond which a reading is not on the surface
    as_one: float = 4.0  # readings that err together, of the spread points
    least_cosine: float = 0.2
    hidden_m: float = 0.02  # a point so far behind another surface of the model is hidden by it
    coloured: int = 3000  # points of the surface whose colours are compared
    least_coloured: int = 200
    coloured_as_one: float = 8.0  # whose greys err together: voxels and pixels of half a centimetre
    blur_px: float = 1.0  # of the image: a voxel's colour is the mean of its readings
    hidden_cell_px: int = 8  # of the depth buffer that says so


@dataclass(frozen=True, slots=True)
class SearchConfig:
    """The search over the whole range."""

    most_m: float = 0.6  # of a joint whose stop is not known: the paper looks to 0.5 m
    most_rad: float = float(np.deg2rad(120.0))  # and to 90 deg
    below: float = 0.05  # of the range, on the closed side
    step_m: float = 0.006  # of the farthest part of the surface, between two states
    most_states: int = 241
    least_log_odds: float = 12.0  # for being there at all, against a scene without the part
    # Of the readings: a part in its place has nearly all on its surface; other furniture a third.
    least_on: float = 0.5
    most_behind: float = 0.15
    least_readings: int = 30
    elsewhere: int = 4  # every how manieth state is tried where a followed part seems hidden
    apart_sigmas: float = 4.0  # hypotheses nearer than this are one
    # Of the readings at the belief, of a part that is held: no look-alike elsewhere is it then.
    on_as_believed: float = 0.9
    kept: int = 5


@dataclass(frozen=True, slots=True)
class SilhouetteConfig:
    """Where a part stands whose surface is not seen: as a board, along the rays of the image."""

    points: int = 6000  # of the part's surface, spread: no cell between them stays empty
    static_points: int = 20_000  # of what rests
    flat_m: float = 0.008  # from the plane of most points, a point is of the board's front
    board_m: float = 0.018  # thickness: fronts of furniture are 15 to 22 mm thick
    layers: tuple[float, ...] = (0.5, 1.0)  # of the thickness, behind the front
    cell_px: int = 4
    slack_m: float = 0.015  # of a cell's depths: of the surface, the joint and the sensor
    explained_m: float = 0.02  # from what rests, a reading is of that
    # Shares of readings along rays that a board covers, as of `LikelihoodConfig`.
    on: float = 0.80
    before: float = 0.17
    behind: float = 0.03
    depth_range_m: float = 1.0
    as_one: float = 4.0  # cells that err together: a stereo camera's window is two cells wide
    # Of the surface's points, turned to the camera enough to be read: a part with more of them is
    # found by its surface or is not there.
    most_facing: float = 0.4
    least_log_odds: float = 20.0  # for standing there, against a scene without the part
    least_cells: int = 60
    least_on: float = 0.7
    most_behind: float = 0.18
    # Of the points' way, beyond the readings: outlines are fattened by the sensor, boards thicker
    # or thinner than taken. On doors of furniture-dev states were off by 0.7 deg, rms.
    outline_m: float = 0.006
    # A followed part is looked for where its belief is so many times wider than an outline tells.
    worth: float = 1.5
    reach_sigmas: float = 4.0  # of the belief, about which it is looked for
    most_floors: float = 2.0  # a deviation beyond so many of that is of several places, not of one
    static_off_m: float = 0.03  # behind where it should be, what rests is not there
    least_static: float = 0.8  # of what rests, where nothing stands before it


@dataclass(frozen=True, slots=True)
class MotionConfig:
    """How a part moves when nobody says how."""

    rate_sd_m_s: float = 0.05  # of a second of unknown motion: a hand opens at 0.1 m/s
    rate_sd_rad_s: float = 0.2
    damping_s: float = 0.5  # time after which a rate is forgotten
    hand_m: float = 0.0004  # of the hand against the part, a step: pads give a millimetre in ten
    commanded_share: float = 0.1  # of a commanded way that may not have been gone
    # Of a part that an arm takes hold of, while that reaches for it: fingers that close push it so.
    touched_m: float = 0.002
    reach_s: float = 30.0  # longer than any takes: who knows what moved it then


@dataclass(frozen=True, slots=True)
class RelocalizationConfig:
    """All of it."""

    likelihood: LikelihoodConfig = field(default_factory=LikelihoodConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    silhouette: SilhouetteConfig = field(default_factory=SilhouetteConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    match: KnownSurfaceConfig = field(default_factory=KnownSurfaceConfig)
    gate_nis: float = 10.8  # of an innovation, one degree of freedom: one in a thousand beyond
    least_found: float = 0.3  # of the points that should be seen, that must be on the surface
    # So few, of a front that is nearly edge-on, are its outline's pixels: Gauss-Newton ends where
    # it began, a degree off and sure of it, unless most of what should be seen is among them.
    sliver: int = 60
    least_of_sliver: float = 0.6
    patience: int = 3  # frames that contradict the belief before it is given up
    shared_m: float = 0.0005  # of the surface and a frame's depth, that all readings share
    sure: float = 0.99  # probability of one hypothesis from which the others are let go
    # Of the points' way along their normals: with less the part slides along its own surface, and
    # its outline tells more than its depth.
    outline_along: float = 0.35
    outline_reaches_m: tuple[float, ...] = (0.06, 0.012)  # about the state that depth tells
    outline_states: int = 17
    outline_px: float = 0.35  # of a pixel's width: edges of depth are fattened by so much
