"""The state of one frame from its depth image, where too few tracks of the part are seen in it.

The joint and the part's patches are held as the leading kind has them. The patches are looked for
(`akm_fg.perception.surface.known_surface`) from the last state and from places beside it: whichever
start finds most of them again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from akm_fg.estimation.between_kinds.weighed_kinds import FittedKinds
from akm_fg.estimation.one_kind.laplace import KindFit
from akm_fg.estimation.sources.source import Source
from akm_fg.estimation.sources.surface import SURFACE, SurfaceContribution, SurfaceSource
from akm_fg.perception.depth.depth_noise import DepthNoiseModel
from akm_fg.perception.surface.known_surface import Found, KnownSurface, KnownSurfaceConfig
from akm_fg.posterior import ArticulationPosterior
from akm_fg.records import FloatArray, RgbdFrame
from factors.measurements.dense_registration import dense_cost


@dataclass(frozen=True, slots=True)
class SurfaceStateConfig:
    """Finding the part's surface again."""

    patches: int = 400  # looked for, of thousands: errors of neighbours agree
    match: KnownSurfaceConfig = field(default_factory=KnownSurfaceConfig)
    search_m: tuple[float, ...] = (0.0, 0.03, -0.03, 0.06, -0.06)  # way of the part from the start
    least_share: float = 0.3  # of the patches that must be found: less is something else,
    least_found: float = 0.1  # or so many, where depth is lost in patches, if they are
    least_of_read: float = 0.6  # this share of those in whose place there is any depth
    least_along: float = 0.05  # of the patches' way along their normals: with less it is open
    longest_gap: int = 2  # frames beyond the last known state from which one is believed
    steps_a_frame: float = 4.0  # of the path's usual step, that a part may go in a frame
    sigmas: float = 5.0  # that a state may be off the path whatever the steps are


@dataclass(frozen=True, slots=True)
class HeldSurface:
    """The patches of a leading kind, and what its states are known by."""

    surface: KnownSurface
    as_one: float  # of these patches' readings, that err together
    scale: float  # of the readings' noise
    fit: KindFit

    @staticmethod
    def of(
        fit: KindFit, sources: Sequence[Source], config: SurfaceStateConfig
    ) -> HeldSurface | None:
        """The patches that a moving kind was fitted to; None where it has none."""
        found = [each for each in sources if isinstance(each, SurfaceSource)]
        said = fit.said.get(SURFACE)
        if not found or said is None:
            return None
        assert isinstance(said, SurfaceContribution)
        (source,) = found
        patches = source.patches
        R, t = fit.moving.motion(fit.q[source.frames])
        x = dense_cost(R, t, patches, source.config.dof, said.scale).x_world
        S = x.shape[1]
        some = np.unique(np.linspace(0, S - 1, min(S, config.patches)).astype(int))
        as_one = max(1.0, said.count_as_one * fit.as_one * some.size / S)
        known = KnownSurface(fit.moving, x.T[some], patches.normal_world.T[some])
        return HeldSurface(known, as_one, max(said.scale, 1.0), fit)

    def state(
        self, frame: RgbdFrame, noise: DepthNoiseModel, start: float, config: SurfaceStateConfig
    ) -> tuple[float, float] | None:
        """State of a frame and its standard deviation; None where the surface is not seen.

        Args:
            frame: its depth.
            noise: of single readings.
            start: roughly the state.
            config: tuning.
        """
        surface = self.surface
        starts = start + np.array(config.search_m) / surface.metres_per_unit(start)
        best = surface.solved(frame, noise, starts, config.match)
        if not _found_again(best, len(surface.x_world), config):
            return None
        metres = surface.metres_per_unit(best.q)
        if best.along_m < config.least_along * metres:
            return None
        order = np.argsort(self.fit.q)
        beyond = float(np.interp(best.q, self.fit.q[order], self.fit.state_sd[order] ** 2))
        own = self.as_one * self.scale**2 / best.information
        return best.q, float(np.sqrt(own + beyond))


def _found_again(found: Found, patches: int, config: SurfaceStateConfig) -> bool:
    """Whether it is the part that is seen, of so many patches."""
    if found.found >= config.least_share * patches:
        return True
    enough = max(config.least_found * patches, config.least_of_read * found.read)
    return found.found >= enough


def with_surface_states(
    posterior: ArticulationPosterior,
    fitted: FittedKinds,
    frames: Mapping[int, RgbdFrame],
    noise: DepthNoiseModel,
    config: SurfaceStateConfig | None = None,
) -> ArticulationPosterior:
    """With states of the best kind in frames that neither its graph nor a track tells of.

    Args:
        posterior: of the fitted kinds.
        fitted: these.
        frames: by their numbers, those whose images are there.
        noise: of single readings.
        config: tuning.
    """
    config, best = config or SurfaceStateConfig(), posterior.best
    if best.joint is None or best.states is None:
        return posterior
    (fit,) = (each for each in fitted.fits if each.kind == best.joint.kind)
    surface = HeldSurface.of(fit, fitted.problem.sources, config)
    if surface is None:
        return posterior
    mean, sd = best.states.mean.copy(), best.states.sd.copy()
    known = np.flatnonzero(np.isfinite(mean))
    for number in sorted(set(frames) - set(known.tolist())):
        told = np.flatnonzero(np.isfinite(mean))
        start = float(np.interp(number, told, mean[told]))
        found = surface.state(frames[number], noise, start, config)
        if found is not None and _on_the_path(number, *found, mean, sd, config):
            mean[number], sd[number] = found
    return posterior.with_states(mean, sd)


def _on_the_path(
    number: int,
    q: float,
    q_sd: float,
    mean: FloatArray,
    sd: FloatArray,
    config: SurfaceStateConfig,
) -> bool:
    """Whether a state lies where the part may have gone from the states beside it.

    What looks like the part may be what it has left (the base of a laptop, the case of a box): a
    state that jumps against the path, or follows on frames that nobody knows, is not believed.

    Args:
        number: of the frame.
        q: its state.
        q_sd: that state's standard deviation.
        mean: (T,) states so far; NaN where not known.
        sd: (T,) their standard deviations.
        config: tuning.
    """
    told = np.flatnonzero(np.isfinite(mean))
    steps = np.abs(np.diff(mean[told])) / np.diff(told)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    before, after = told[told < number], told[told > number]
    sides = [side for side in (before[-1:], after[:1]) if side.size]
    near = [int(side[0]) for side in sides]
    gaps = [abs(number - k) for k in near]
    if len(near) < 2 and min(gaps, default=0) > config.longest_gap:
        return False
    slack = [
        max(config.steps_a_frame * usual * gap, config.sigmas * float(np.hypot(q_sd, sd[k])))
        for k, gap in zip(near, gaps, strict=True)
    ]
    low = min(mean[k] - s for k, s in zip(near, slack, strict=True))
    high = max(mean[k] + s for k, s in zip(near, slack, strict=True))
    return bool(low <= q <= high)
