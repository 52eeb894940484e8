"""Tuning of the estimator: every number with its unit and reason."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import ClassVar

from akm_fg.geometry.rigid_motion import RigidMotionConfig


@dataclass(frozen=True, slots=True)
class PriorConfig:
    """Proper priors: what the evidence of a kind is measured against."""

    hinge_distance_m: float = 0.3  # median distance of a hinge from the part's middle
    handle_distance_m: float = 0.6  # from the marker of a pose log: it sits on a handle
    hinge_distance_sigma_log: float = 0.6  # 95 % of hinges between a third and three times that
    motion_that_matters_m: float = 0.01  # rest is named where such a travel would have been seen
    least_travel_m: float = 0.001  # the travel is log-uniform from here, less is no motion,
    largest_travel_m: float = 1.0  # to here
    pitch_sigma_m_per_rad: float = 0.05  # of helical joints: 30 cm a turn
    hinge_play_m_per_rad: float = 0.004  # a hinge slides so much along its axis: 3 mm over 40 deg,
    hinge_play_turn_rad: float = 0.7  # and to and fro over larger turns
    kind_probability: dict[str, float] = field(
        default_factory=lambda: {
            "rigid": 0.06,  # who looks at a part has moved it, or tried to
            "prismatic": 0.468,
            "revolute": 0.468,
            "helical": 0.004,  # screws are rare in furniture
        }
    )


@dataclass(frozen=True, slots=True)
class SurfaceConfig:
    """Registration of the surface in keyframes."""

    keyframes: int = 5  # as the paper
    # Where depth leads: a plain part's few tracks tell the states of no other frame. A turning
    # plane tells how deep its hinge lies by 1 - cos of its turn alone: every frame is welcome.
    keyframes_alone: int = 20
    associations: int = 4  # rounds; the first gates take up what the tracks were off
    rough_associations: int = 2  # of these, that only bring the joint near: patches are thinned
    rough_patches: int = 1000  # to so many; errors of neighbours agree anyway
    first_gate_m: float = 0.03
    gate_sigmas: float = 6.0  # of what the last round left
    least_gate_m: float = 0.004
    min_patches: int = 50  # fewer say less than the tracks
    opaque: float = 0.5  # more of the patches seen through than seen: the part is elsewhere
    least_shared: float = 0.1  # of the patches of the view with fewer: what ties two views,
    least_shared_patches: int = 10  # at least
    usual_steps: float = 4.0  # that a part may go and come back by from one frame to the next
    # Sides of blocks that may err together, each twice the last.
    blocks_px: ClassVar[tuple[int, ...]] = (8, 16, 32, 64)


@dataclass(frozen=True, slots=True)
class SamplingConfig:
    """Sampling of joints that the data leave vague (`sampled_posterior`)."""

    vague: float = 0.05  # sd of a tilt (rad) or of a log distance that Laplace still bears
    samples: int = 256
    tail_dof: float = 6.0  # of the proposal
    wider: float = 1.15  # the proposal over its samples
    passes: int = 6
    enough: float = 0.5  # effective share of the samples that ends the passes
    learnable: float = 0.2  # the share that the next proposal is made from
    too_few: float = 0.1  # with less, samples tell of the few that weigh most
    least_probability: float = 1e-3  # of a kind beside one that is named, to be worth it
    region: float = 0.95  # of the posterior is to lie in the ellipsoid of that probability


@dataclass(frozen=True, slots=True)
class GraspConfig:
    """Noise of the gripper's pose in the part while it holds."""

    sigma_trans_m: float = 0.003  # hand-eye calibration, kinematics, play in the fingers
    sigma_rot_rad: float = 0.15  # fingers turn on a bar
    dof: float = 4.0  # of the Student-t noise: jerks and frames in mid-slip
    frames_as_one: float = 5.0  # such errors last: neighbouring frames that err together


@dataclass(frozen=True, slots=True)
class HandPathConfig:
    """How truly a hand that holds a part goes with it; see `akm_fg.stream.hand_path`.

    Read off 49 pulls of `furniture-dev` against the simulator's truth, but for the turn: joint
    zeros that are 0.05 deg off (`sim.camera.rig`), some four of which turn the hand's path.
    """

    jitter_m: float = 1.5e-4  # give of arm and pads, new in every frame
    slip_m_per_sqrt_m: float = 1e-3  # of the held point, as a random walk along the hand's way
    slip_dof: float = 1.0  # Student-t: a grip settles by millimetres in the first centimetres
    steady: float = 2e-3  # slip over way, the same all along it
    turn_rad: float = math.radians(0.1)  # of the whole path, by the joints' zeros
    lever_m: float = 0.012  # between the hand's point and the one that it turns about in its grasp
    camera_dof: float = 4.0  # Student-t: how far a camera that claims too much may be overruled
    # Beyond so much, and as much again where a state is vague, what was seen is not what is held.
    away_m: float = 0.025  # grips slip by up to 8 mm, and turn about what is 1.4 cm away
    away_sigmas: float = 4.0
    kind_nats: float = 3.6  # that it says at most of turning against sliding: wrong on 2 of 75
    most_frames: int = 40  # neighbouring frames of a long pull tell the same
    iterations: int = 8


@dataclass(frozen=True, slots=True)
class FitConfig:
    """How a fit is done and what counts as an answer."""

    prior: PriorConfig = field(default_factory=PriorConfig)
    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    rigid_motion: RigidMotionConfig = field(default_factory=RigidMotionConfig)
    dof: float = 6.0  # of the Student-t noise: 97 % efficient on Gaussian noise, see docs
    max_frames: int = 60  # frames in the graph; the others get their states afterwards
    cost_tolerance: float = 0.05  # nats; a step that gains less moves by a tenth of a sigma
    rough_cost_tolerance: float = 1.0  # nats; while starts, kinds and noise scales are compared
    max_iterations: int = 30  # of Levenberg-Marquardt a round; a good start takes five
    rough_scale_tolerance: float = 0.1  # relative change that ends them while comparing
    rough_iterations: int = 12  # of Levenberg-Marquardt a round, while starts are compared
    sampling: SamplingConfig = field(default_factory=SamplingConfig)
    much_nearer: float = 0.5  # a screw read off the motions starts a hinge if it costs so much less
    screw_gain: float = 3.0  # nats over its hinge; with less, the pitch's prior decides against it
    near_known: float = 1.2  # a start whose own noise is within this factor begins at the known
    ranking_tracks: int = 40  # are enough to tell a good start from a bad one
    static_tracks: int = 20  # tell the noise level to three percent, in 8 ms
    static_frames: int = 20
    solve_within: float = 10.0  # nats behind; a start fitted to free motions is off by a tenth
    polish_within: float = 50.0  # nats of evidence behind; starts of a path are rough
    scale_iterations: int = 6  # rounds of: solve, estimate the noise scale
    still_scale_iterations: int = 1  # of a kind that is out of the race
    scale_tolerance: float = 0.02  # relative change of the noise scale that ends the rounds
    # Of recordings whose camera's calibration errs: the hand's path beside it (`stream.hand_path`).
    hand_path: HandPathConfig | None = field(default_factory=HandPathConfig)
    grasp: GraspConfig | None = None  # of recordings; None: the gripper's poses are not used
    moving_noise: float = 1.25  # of a moving part's tracks, over that of a static part's
    moving_noise_sd_log: float = 0.2  # standard deviation of its logarithm, from part to part
    noise_prior_observations: float = 20.0  # weight of a given noise level, as observations
    undecided_below: float = 0.95  # probability a kind needs to be named
    systematic_share: float = 0.02  # of the travel: marker bias, flexing parts, play in the hinge
    camera_systematic_m: float = 2e-4  # of a recording: what no averaging removes (calibration)
    sound_noise_scale: float = 0.6  # of recordings' tracks on texture, over what lifting claims
    surface_systematic_m: float = 5e-5  # of the depth along the normal, likewise unaveraged
    systematic_modes: int = 4  # independent ways in which such errors bend what is seen
    surface_noise_limit: float = 1.0  # of single depth readings; smoothed ones are at a third
    # Orientations of a pose log: a hand tilts in its grasp by one to two degrees, a tag's
    # orientation is biased as much with the view (docs/decisions/0017).
    orientation_systematic_rad: float = 0.026  # 1.5 degrees, or, of noisy ones,
    orientation_bias_share: float = 2.0  # times their noise: a tag's corners are off by both
    orientation_noise_limit: float = 5.0  # of what a fit may find, in what is known beforehand
    orientation_misfit: float = 3.0  # times what is known that still explains a kind's residuals
    largest_share_left_out: float = 0.1  # of a log's rows that jump; with more no kind is named
    countable_turn_rad: float = 2.4  # between frames; nearer to half a turn it may be the other way
    doubt: float = (
        1.5  # a pose log's kind is named if it holds with systematic errors so many times
    )
    beyond_doubt: float = 0.9995  # evidence of so much holds with such errors, unasked
    disagreement_chance: float = 1e-3  # that sources which agree look as if they did not
    least_new: float = 0.1  # of the tracks' variance, that the others are taken to have brought
    parametric_p_value: float = 1e-3  # chi-square level below which no kind explains the data
    largest_rest: float = 0.5  # of how far all that is seen lies apart, that may stay unexplained

    @property
    def doubtful(self) -> FitConfig:
        """With larger systematic errors of poses: what is only supposed may be so wrong."""
        return replace(
            self,
            systematic_share=self.doubt * self.systematic_share,
            orientation_systematic_rad=self.doubt * self.orientation_systematic_rad,
            orientation_bias_share=self.doubt * self.orientation_bias_share,
        )
