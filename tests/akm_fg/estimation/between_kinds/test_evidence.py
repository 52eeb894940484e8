"""Weighing the kinds: what counts as one, systematic errors, and screws against their hinges."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from akm_fg.estimation.between_kinds.evidence import (
    _largest_by_chance,
    is_parametric,
    kind_probabilities,
    nested_screw,
    rest_is_shown,
)
from akm_fg.estimation.between_kinds.starts import starts_of_part
from akm_fg.estimation.config import FitConfig, PriorConfig
from akm_fg.estimation.fit import fit_tracks
from akm_fg.estimation.given.problem import problem_of_surface, problem_of_tracks
from akm_fg.estimation.given.surface_registration import register
from akm_fg.estimation.one_kind.kind_fit import fit_kind
from akm_fg.estimation.one_kind.laplace import inverted
from akm_fg.estimation.sources.source import FirstFit
from akm_fg.estimation.sources.surface import SURFACE
from akm_fg.estimation.sources.tracks import TRACKS
from akm_fg.geometry.joint_guess import JointGuess
from akm_fg.io.posteriors.posterior_json import posterior_as_dict
from akm_fg.posterior import Evidence
from akm_fg.steps import to_end
from factors.joint import Joint, JointKind

# Noise whose level is fitted freely: the sandwich factor of its residuals is one.
GAUSSIAN = replace(FitConfig(), dof=1e6, noise_prior_observations=0.0)


def _problem(tracks, config=None):
    return problem_of_tracks("test", tracks, True, 0, config or FitConfig())


def _fits(problem):
    starts = starts_of_part(problem, problem.motions)
    return {s.guess.kind: fit_kind(s.guess, problem) for s in starts}


def _with(problem, **settings):
    """The problem with other settings of its tracks."""
    return problem.with_source(replace(problem.tracks, **settings))


def _registered(problem, guess, surface):
    known = {TRACKS: problem.tracks.first_scale, SURFACE: 1.0}
    first = FirstFit(guess, np.zeros(guess.q.size), known, 1.0)
    problem, first = to_end(register(problem, first, surface, problem.config.surface.keyframes))
    return problem, first.guess


@pytest.fixture(scope="module")
def door(opening):
    """A door's problem and its fits of all moving kinds, every observation counted."""
    problem = _problem(opening(0, "revolute").tracks)
    return problem, _fits(problem)


def test_terms_of_the_evidence_add_up():
    terms = Evidence(5.0, -1.0, -2.0, 0.5, -0.25)
    assert terms.total == 2.25


def test_json_gives_every_kinds_evidence_term_by_term(kind, opening):
    posterior = fit_tracks(opening(0, kind).tracks)
    fields = posterior_as_dict(posterior)["evidence"]
    assert set(fields) == {"rigid", "prismatic", "revolute", "helical"}
    for name, terms in fields.items():
        parts = {k: v for k, v in terms.items() if k != "log_evidence"}
        assert set(parts) == {field.name for field in dataclasses.fields(Evidence)}
        assert_allclose(sum(parts.values()), terms["log_evidence"])
        assert terms["log_evidence"] == posterior.alternatives[name].log_evidence
        assert all(np.isfinite(v) for v in terms.values())


def test_probabilities_are_evidence_times_prior(door):
    problem, fits = door
    two = [fits["revolute"], fits["helical"]]
    p = kind_probabilities(two, problem.config.prior)
    prior = problem.config.prior.kind_probability
    odds = two[1].log_evidence - two[0].log_evidence + np.log(prior["helical"] / prior["revolute"])
    assert_allclose(np.log(p["helical"] / p["revolute"]), odds)
    assert p["rigid"] == p["prismatic"] == 0.0


def test_counting_one_in_four_quarters_likelihood_and_states_and_widens_by_four(door):
    _, fits = door
    fit = fits["revolute"]
    one, four = fit.tempered(1.0), fit.tempered(4.0)
    assert_allclose(one.cov, fit.cov)
    sd = np.sqrt(np.diag(fit.cov))  # the priors count once, whatever the tracks do
    assert_allclose(four.cov / np.outer(sd, sd), 4 * fit.cov / np.outer(sd, sd), atol=2e-3)
    assert_allclose(four.evidence.log_likelihood, one.evidence.log_likelihood / 4)
    assert_allclose(four.evidence.log_states, one.evidence.log_states / 4)
    assert four.evidence.log_joint_prior == one.evidence.log_joint_prior
    gained = four.evidence.log_joint_volume - one.evidence.log_joint_volume
    assert_allclose(gained, 0.5 * 4 * np.log(4), atol=1e-2)  # but for what the priors tell


def test_systematic_errors_widen_the_covariance_and_leave_the_evidence_alone(door):
    """By hand: n observations of variance s^2 and m modes of b^2 weigh n b^2 / (m s^2) more."""
    problem, fits = door
    fit = fits["revolute"]
    plain, wide = (
        fit_kind(fit.guess, _with(problem, systematic_m=b), fit, "none") for b in (0.0, 1e-3)
    )
    n = problem.tracks.observations.observed.sum()
    variance = (0.003 * min(plain.tracks.scale, problem.config.sound_noise_scale)) ** 2
    want = 1 + n * 1e-6 / (problem.config.systematic_modes * variance)
    sd = np.sqrt(want * np.diag(plain.cov))
    got, expected = wide.cov / np.outer(sd, sd), want * plain.cov / np.outer(sd, sd)
    assert_allclose(got, expected, atol=2e-3)  # but for the priors, which do not err
    assert wide.log_evidence == plain.log_evidence


@pytest.fixture(scope="module")
def with_surface(opening, surface_of):
    """A door's problem with tracks and surface, and its hinge; Gaussian noise."""
    truth = opening(3, "revolute")
    config = replace(GAUSSIAN, surface_systematic_m=0.0)
    alone = _problem(truth.tracks, config)
    start = next(s for s in starts_of_part(alone, alone.motions) if s.guess.kind == "revolute")
    problem, guess = _registered(alone, start.guess, surface_of(truth))
    return problem, fit_kind(guess, problem)


def _erring(problem, surface_m, tracks_m):
    """The problem with systematic errors of its surface and of its tracks."""
    surface = problem.sources[1]
    config = replace(surface.config, surface_systematic_m=surface_m)
    erring = problem.with_source(replace(surface, config=config))
    return _with(erring, systematic_m=tracks_m)


def test_with_all_counts_one_the_covariance_of_both_sources_is_the_graphs_own(with_surface):
    _, fit = with_surface
    assert SURFACE in fit.said
    cov = inverted(JointKind.REVOLUTE, fit.information)
    tempered = fit.tempered(1.0)
    sd = np.sqrt(np.diag(cov))
    assert_allclose(tempered.cov / np.outer(sd, sd), cov / np.outer(sd, sd), atol=0.05)
    assert tempered.log_evidence == fit.log_evidence


def test_each_source_widens_by_its_own_count(with_surface):
    """The sandwich worked from the graph's information and the patches' share of it."""
    problem, fit = with_surface
    both = _erring(problem, 2e-4, 5e-4)
    H_tracks, H_surface = (fit.said[name].information for name in (TRACKS, SURFACE))
    cov = np.linalg.inv(fit.information)
    surface = problem.sources[1]
    n = surface.patches.seen.sum()
    variance = fit.scales[SURFACE] ** 2 / np.median(surface.patches.precision[surface.patches.seen])
    readings = 3.0 + n * 2e-4**2 / (4 * variance) / surface.count_as_one
    tracks = problem.tracks.observations.observed.sum()
    sound = min(fit.tracks.scale, problem.config.sound_noise_scale)
    points = 3.0 + tracks * 5e-4**2 / (4 * (0.003 * sound) ** 2)
    want = cov @ (points * H_tracks + readings * H_surface + fit.prior_information) @ cov
    sd = np.sqrt(np.diag(want))
    got = fit_kind(fit.guess, both, fit, "none").tempered(3.0).cov
    assert readings > 1.2 * 3 and points > 1.2 * 3 and abs(points / readings - 1) > 0.1
    assert_allclose(got / np.outer(sd, sd), want / np.outer(sd, sd), atol=0.05)


def test_the_covariance_grows_with_either_count_and_stays_positive_definite(with_surface):
    problem, fit = with_surface

    def covariance(as_one, surface_m, tracks_m):
        erring = _erring(problem, surface_m, tracks_m)
        return fit_kind(fit.guess, erring, fit, "none").tempered(as_one).cov

    least = covariance(1.0, 0.0, 0.0)
    d = np.sqrt(np.diag(least))
    assert np.linalg.eigvalsh(least / np.outer(d, d))[0] > 0
    for more in ((2.0, 0.0, 0.0), (1.0, 1e-3, 0.0), (1.0, 0.0, 1e-2), (5.0, 1e-2, 1e-1)):
        wide = covariance(*more)
        grown = np.linalg.eigvalsh((wide - least) / np.outer(d, d))
        assert grown[-1] > 1e-2, more
        assert grown[0] > -1e-9 * grown[-1], more
        d_wide = np.sqrt(np.diag(wide))
        assert np.linalg.eigvalsh(wide / np.outer(d_wide, d_wide))[0] > 0, more


def test_a_screw_keeps_its_evidence_where_no_systematic_errors_are(door):
    """Of a linear Gaussian problem both ways to its odds would agree; Laplace's error is left."""
    problem, fits = door
    weighed = nested_screw([f.tempered(1.0) for f in fits.values()], problem)
    by_kind = {fit.kind: fit for fit in weighed}
    assert -0.5 < by_kind["helical"].log_nested <= 0.0
    assert by_kind["revolute"].log_nested == by_kind["prismatic"].log_nested == 0.0


def test_a_pitch_within_systematic_errors_wins_nothing(door):
    """Against a hinge whose screw lies twenty claimed deviations of pitch away from zero."""
    problem, fits = door
    rigid_hinge = replace(problem.config.prior, hinge_play_m_per_rad=1e-9)
    problem = replace(problem, config=replace(problem.config, prior=rigid_hinge))
    screw = fits["helical"]
    pitch = 20 * screw.pitch_sd
    lead = 0.5 * 20**2 + np.log(screw.pitch_sd / problem.config.prior.pitch_sigma_m_per_rad)
    log_prior = screw.log_prior + fits["revolute"].log_evidence + lead - screw.log_evidence
    ahead = replace(screw, joint=replace(screw.joint, pitch=pitch), log_prior=log_prior)
    fits = [ahead, fits["revolute"]]
    exact = nested_screw(fits, problem)[0]
    assert_allclose(exact.log_nested, 0.0, atol=1e-6)
    assert exact.log_evidence - fits[1].log_evidence > 150
    wide = [replace(f, said=_erring_tracks(f, problem, 0.05)).tempered(1.0) for f in fits]
    weighed = nested_screw(wide, problem)
    assert wide[0].pitch_sd > 10 * screw.pitch_sd
    # What is left is the pitch's own density at zero over its prior's, by hand.
    sd, sigma = wide[0].pitch_sd, problem.config.prior.pitch_sigma_m_per_rad
    want = 0.5 * (pitch / sd) ** 2 + np.log(sd / sigma)
    assert_allclose(weighed[0].log_evidence - weighed[1].log_evidence, want, atol=1e-6)
    assert weighed[0].log_nested < -100


def _erring_tracks(fit, problem, systematic_m):
    """What the tracks of a fit say, with systematic errors."""
    said, source = fit.tracks, replace(problem.tracks, systematic_m=systematic_m)
    beyond = source.systematic_points(said.scale, said.noise_variance)
    return {TRACKS: replace(said, variance_fixed=said.variance_per_as_one * beyond)}


def test_without_a_screw_or_without_its_hinge_nothing_is_weighed(door):
    problem, fits = door
    for kinds in (("revolute", "prismatic"), ("helical", "prismatic")):
        given = [fits[kind] for kind in kinds]
        assert nested_screw(given, problem) == given


def test_a_pitch_within_a_hinges_play_makes_no_screw(door):
    """Three millimetres a radian, known to a tenth of that: a hinge that slides a little."""
    problem, fits = door
    screw = fits["helical"]
    k = len(screw.joint.kind.observable)
    cov = screw.cov.copy()
    cov[k, k] = 3e-4**2
    log_prior = screw.log_prior + fits["revolute"].log_evidence + 40 - screw.log_evidence
    joint = replace(screw.joint, pitch=0.003)
    ahead = replace(screw, joint=joint, cov=cov, log_prior=log_prior)
    weighed = nested_screw([ahead, fits["revolute"]], problem)
    assert weighed[0].log_evidence < weighed[1].log_evidence


def test_where_the_surface_says_more_it_decides_whether_a_joint_explains(opening, surface_of):
    """Two wild tracks contradict no joint that a thousand readings of its surface agree with."""
    truth = opening(0, "revolute", points=4, noise_m=0.05)
    guess = JointGuess(Joint("revolute", truth.T_world_joint, 0.0), truth.q)
    alone = problem_of_surface("x", truth.tracks, guess, truth.rest_world.mean(axis=0), FitConfig())
    alone = replace(alone, local_scale=1.0)
    problem, guess = _registered(alone, guess, surface_of(truth))
    fit = fit_kind(guess, problem)
    assert not is_parametric(replace(fit, said={TRACKS: fit.tracks}), problem, 1.0)
    assert is_parametric(fit, problem, 1.0)
    rough = problem.with_source(replace(problem.sources[1], first_scale=1.5))
    config = replace(rough.config, still_scale_iterations=0)  # its noise as it is given
    assert not is_parametric(
        fit_kind(guess, replace(rough, config=config), None, "none"), rough, 1.0
    )


@pytest.mark.parametrize(("gained", "shown"), [(20.0, True), (28.0, False)])
def test_rest_is_contradicted_by_more_than_noise_can_gain(gained, shown, door):
    """19 free states of a drawer: noise alone gains 24 nats or more once in a hundred times."""
    _, fits = door
    drawer = replace(fits["prismatic"], as_one=1.0)
    behind = replace(drawer.tracks, log_likelihood=drawer.tracks.log_likelihood - gained)
    rest = replace(drawer, joint=None, said={TRACKS: behind})
    assert rest_is_shown([rest, drawer], PriorConfig()) is shown
    assert _largest_by_chance(19, 3) == pytest.approx(47.0, abs=1.0)  # twice the nats


@pytest.mark.parametrize(("sd_m", "shown"), [(0.0012, True), (0.0018, False)])
def test_rest_is_named_only_where_a_centimetre_would_have_been_seen(sd_m, shown, door):
    """19 states even over 1 cm have squares of 1.58 cm^2 in all: 110 of (1.2 mm)^2, 49 of 1.8 mm.

    With 19 free states at rest, 47 is passed by noise once in a hundred times; 19 + 49 with a
    standard deviation of 15 falls short of it too often, 19 + 110 with 22 does not.
    """
    _, fits = door
    drawer = replace(fits["prismatic"], as_one=1.0)
    drawer = replace(drawer, information=np.eye(drawer.information.shape[0]) / sd_m**2)
    rest = replace(drawer, joint=None)
    assert rest_is_shown([rest, drawer], PriorConfig()) is shown


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_joint_that_nothing_is_known_of_is_worth_what_its_prior_is(door, kind):
    """Prior density at the solution times the width is the prior's own integral: at most one."""
    _, fits = door
    fit = fits[kind]
    k = len(fit.widest)
    known = fit.prior_information
    vague = replace(fit, judged=known + 1e-9 * (fit.judged - known))
    of_states = np.linalg.slogdet(vague.judged[k:, k:])[1] - fit.log_held
    occam = vague.evidence.log_joint_prior + vague.evidence.log_joint_volume + of_states / 2
    assert occam < 0.01
    sure = fit.evidence.log_joint_prior + fit.evidence.log_joint_volume
    assert sure < occam - 5
