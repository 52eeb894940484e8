"""Adam, its step halved on a plateau, stopped early; the best iterate wins.

Adam is Algorithm 1 of Kingma and Ba (ICLR 2015). It is written out because constructing torch's
own loads the compiler of torch, which takes longer than most fits; a test holds the two together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from experiments.baselines.config import DescentConfig

_MEAN_DECAY, _SQUARE_DECAY, _EPSILON = 0.9, 0.999, 1e-8  # the paper's, and torch's defaults
# Of the loss: a smaller relative gain still counts as a plateau (torch's default).
_PLATEAU_GAIN = 1e-4


@dataclass(frozen=True, slots=True)
class Evaluation:
    """One evaluation of the loss; its gradients are in the parameters."""

    loss: float  # judges progress; of several starts the lowest
    best_row: int = 0  # of parameters that hold several starts, the row that `loss` belongs to


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where the descent ended."""

    parameters: tuple[Tensor, ...]  # of the best evaluation, detached
    best_row: int
    loss: float  # infinite when there was nothing to minimise at the start
    losses: tuple[float, ...]  # of every evaluation
    steps: tuple[float, ...]  # with which each was left


class Adam:
    """Adam's moments of some parameters."""

    def __init__(self, parameters: Sequence[Tensor]) -> None:
        self._parameters = tuple(parameters)
        self._means = tuple(torch.zeros_like(p) for p in parameters)
        self._squares = tuple(torch.zeros_like(p) for p in parameters)
        self._count = 0

    def descend(self, step: float) -> None:
        """Change the parameters in place by their gradients, then forget the gradients."""
        self._count += 1
        mean_scale = 1 - _MEAN_DECAY**self._count
        square_scale = 1 - _SQUARE_DECAY**self._count
        with torch.no_grad():
            for p, mean, square in zip(self._parameters, self._means, self._squares, strict=True):
                if p.grad is None:
                    raise ValueError("a parameter has no gradient: the loss does not depend on it")
                mean.lerp_(p.grad, 1 - _MEAN_DECAY)
                square.mul_(_SQUARE_DECAY).addcmul_(p.grad, p.grad, value=1 - _SQUARE_DECAY)
                root = (square / square_scale).sqrt_().add_(_EPSILON)
                p.addcdiv_(mean, root, value=-step / mean_scale)
                p.grad = None


class Plateau:
    """The step size: shrinks when the loss has not fallen for longer than the patience."""

    def __init__(self, config: DescentConfig) -> None:
        self.step = config.step
        self._config = config
        self._best = float("inf")
        self._waited = 0

    def see(self, loss: float) -> None:
        """Take note of the next loss."""
        if loss < self._best * (1 - _PLATEAU_GAIN):
            self._best, self._waited = loss, 0
            return
        self._waited += 1
        if self._waited > self._config.plateau_patience:
            self.step *= self._config.plateau_factor
            self._waited = 0


def minimise(
    parameters: Sequence[Tensor],
    evaluate: Callable[[], Evaluation | None],
    config: DescentConfig,
) -> Minimum:
    """Descend from the parameters' present values; changes them in place.

    Args:
        parameters: leaves that require gradients.
        evaluate: the loss at their present values; adds its gradients to theirs (backward). None
            when nothing is left to minimise.
        config: step and patience.
    """
    adam, plateau = Adam(parameters), Plateau(config)
    best = Evaluation(float("inf"))
    best_parameters = _copies(parameters)
    losses: list[float] = []
    steps: list[float] = []
    waited = 0
    while len(losses) < config.max_iterations and waited < config.stop_patience:
        found = evaluate()
        if found is None:
            break
        waited += 1
        if found.loss < best.loss:
            best, best_parameters, waited = found, _copies(parameters), 0
        plateau.see(found.loss)
        losses.append(found.loss)
        steps.append(plateau.step)
        adam.descend(plateau.step)
    return Minimum(best_parameters, best.best_row, best.loss, tuple(losses), tuple(steps))


def _copies(parameters: Sequence[Tensor]) -> tuple[Tensor, ...]:
    return tuple(p.detach().clone() for p in parameters)
