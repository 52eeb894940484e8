import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (extra `baseline`)")

from experiments.baselines.config import DescentConfig  # noqa: E402
from experiments.baselines.descent import Adam, Evaluation, minimise  # noqa: E402


def _scripted(losses, **settings):
    """A descent that is told these losses, one an iteration, whatever it does."""
    p = torch.zeros(1, requires_grad=True)
    told = iter(losses)

    def evaluate():
        p.sum().backward()
        return Evaluation(next(told))

    return minimise([p], evaluate, DescentConfig(step=1.0, **settings))


def test_the_step_is_halved_once_the_loss_has_not_fallen_for_longer_than_the_patience():
    found = _scripted([3.0, 2.0, *[2.0] * 9], max_iterations=11, stop_patience=99)
    assert found.steps == (1.0,) * 5 + (0.5,) * 4 + (0.25,) * 2


def test_it_stops_early_and_returns_the_best_iterate():
    found = _scripted([3.0, 1.0, *[2.0] * 50], stop_patience=10)
    assert len(found.losses) == 12 and found.loss == 1.0
    np.testing.assert_allclose(found.parameters[0], -1.0)  # one step of Adam from zero


def test_it_ends_at_the_largest_number_of_iterations():
    assert len(_scripted(np.linspace(2, 1, 400), max_iterations=300).losses) == 300


def test_nothing_to_minimise_leaves_the_start():
    p = torch.full((2,), 5.0, requires_grad=True)
    found = minimise([p], lambda: None, DescentConfig(step=1.0))
    assert found.loss == float("inf") and found.parameters[0].tolist() == [5.0, 5.0]


def test_a_parameter_outside_the_loss_is_refused():
    p = torch.zeros(1, requires_grad=True)
    with pytest.raises(ValueError, match="no gradient"):
        minimise([p], lambda: Evaluation(1.0), DescentConfig(step=1.0))


@pytest.mark.slow
def test_adam_and_plateau_are_those_of_torch():
    """Until torch's smallest change of step, 1e-8, would set in."""
    target = torch.tensor([0.3, -2.0, 5.0], dtype=torch.float64)
    ours, theirs = (torch.zeros_like(target, requires_grad=True) for _ in range(2))
    config = DescentConfig(step=0.3, max_iterations=110, stop_patience=200)

    def evaluate():
        loss = ((ours - target) ** 2).sum()
        loss.backward()
        return Evaluation(loss.item())

    found = minimise([ours], evaluate, config)
    reference = torch.optim.Adam([theirs], lr=config.step)
    plateau = torch.optim.lr_scheduler.ReduceLROnPlateau(reference, factor=0.5, patience=3)
    losses = []
    for _ in range(config.max_iterations):
        reference.zero_grad()
        loss = ((theirs - target) ** 2).sum()
        losses.append(loss.item())
        plateau.step(loss.item())
        loss.backward()
        reference.step()
    np.testing.assert_allclose(found.losses, losses, rtol=1e-9, atol=1e-12)
    assert found.steps[-1] < config.step / 4  # plateaus were met on the way
    assert found.steps[-1] == pytest.approx(reference.param_groups[0]["lr"])


def test_the_first_step_of_adam_is_the_step_size_against_the_gradient():
    p = torch.tensor([1.0, 1.0], requires_grad=True)
    (p * torch.tensor([3.0, -0.01])).sum().backward()
    Adam([p]).descend(0.1)
    np.testing.assert_allclose(p.detach(), [0.9, 1.1], atol=1e-5)
