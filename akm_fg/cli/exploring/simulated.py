"""One exploration in the simulator, every attempt recorded as it goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from akm_fg.cli.demo_config import DemoConfig
from akm_fg.cli.exploring.kept import RESULT, Explored, Measured, read_request, write_result
from akm_fg.cli.exploring.outcome import write_outcome, write_part_model
from akm_fg.cli.exploring.scored_recorder import ScoredRecorder
from akm_fg.cli.exploring.stages import explorer_of, perceiver_of
from akm_fg.cli.object_argument import ObjectArgument
from akm_fg.cli.simulated_run import limit_shares, opened_world
from akm_fg.exploration.analogy.remembering import remember
from akm_fg.exploration.explore import explore
from akm_fg.exploration.explore_json import exploration_as_dict
from akm_fg.exploration.records import Exploration
from akm_fg.stages import Stages
from sim.episode import SimEpisode


@dataclass(frozen=True, slots=True)
class ExploreRequest:
    """What to explore, and where to write."""

    object: ObjectArgument
    name: str  # of the object, as the person wrote it
    seed: int
    locked: bool
    folder: Path
    config: DemoConfig
    stages: Stages
    command: str
    remember: Path | None = None  # folder whose memory of contacts grows by what is opened


def explore_in_simulator(
    request: ExploreRequest, then: Callable[[SimEpisode, Explored], None] | None = None
) -> Explored:
    """The exploration; what was tried stays readable when it is interrupted.

    Args:
        request: what to explore.
        then: goes on in the same world, once the model is written.

    Raises:
        InputError: the object cannot be loaded, or the settings cannot be used.
        OutputError: something cannot be written.
    """
    exploration = Exploration()
    if (request.folder / RESULT).exists():
        exploration = read_request(request.folder, request.name, request.seed)
    config = request.config

    def keep() -> None:
        told = {"object": request.name, "seed": request.seed, **exploration_as_dict(exploration)}
        write_result(request.folder, told)

    with opened_world(
        request.object, request.seed, config.sim, "published", request.locked
    ) as world:
        reporter = ScoredRecorder(request.folder, world, keep)
        motion = world.arm.record()
        family = getattr(request.object.spec(request.seed), "family", None)
        perceived = perceiver_of(config, request.stages, family, exploration.notes)
        explorer = explorer_of(
            config, request.stages, perceived, world.calibration, request.folder, request.seed,
            keep,
        )  # fmt: skip
        explored = Explored(exploration, request.folder, world.truth())
        try:
            explore(world.arm, world.camera, explorer, exploration, reporter)
        except KeyboardInterrupt:
            explored.interrupted = True
            exploration.failure = "interrupted"
        explored.truth, explored.parts_truth = reporter.truth(), reporter.parts_truth()
        explored.measured = Measured(
            reporter.largest_state, reporter.pressed_n, limit_shares(motion)
        )
        if request.remember is not None:
            name, family = request.name, family or ""
            count = remember(request.remember, exploration, perceived, name, family)
            if count is not None:
                reporter.stage(f"{count} contacts are remembered in {request.remember}")
        if then is not None:
            explored.model = write_part_model(request.folder, exploration, config)
            then(world, explored)
    explored.model = explored.model or write_part_model(request.folder, exploration, config)
    keep()
    title = f"{request.object.title}, seed {request.seed}"
    write_outcome(title, request.command, request.seed, explored, config)
    return explored
