"""The published schema: what is written fits it, what does not fit is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import akm_fg

jsonschema = pytest.importorskip("jsonschema")


@pytest.fixture(scope="module")
def validator():
    schema = akm_fg.posterior_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_posteriors_of_recordings_logs_and_tracks_fit(
    validator, door_model, drawer_model, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    angles = np.linspace(0, 1.0, 40)
    log = np.stack([0.5 * np.cos(angles), 0.5 * np.sin(angles), 0 * angles], axis=1)
    np.savetxt(tmp_path / "door.log", log + rng.normal(0, 5e-4, log.shape))
    still = np.tile(rng.uniform(-0.2, 0.2, (24, 3)), (12, 1, 1))
    still = still + rng.normal(0, 1e-3, still.shape)
    still[4, 3] = np.nan
    np.savez(tmp_path / "still.npz", points=still, sigma_m=1e-3)
    posteriors = [model.parts[0].posterior for model in (door_model, drawer_model)]
    posteriors += [akm_fg.fit(tmp_path / name) for name in ("door.log", "still.npz")]
    assert "rigid" in [posterior.kind for posterior in posteriors]
    unsure, other = posteriors[:2]
    posteriors.append(replace(unsure, other_parts=(other,)))
    best = unsure.best
    assert best.states is not None
    lost = replace(best.states, mean=np.full_like(best.states.mean, np.nan))
    posteriors.append(
        replace(
            unsure,
            kind="undecided",
            alternatives={**unsure.alternatives, unsure.kind: replace(best, states=lost)},
        )
    )
    for posterior in posteriors:
        validator.validate(json.loads(json.dumps(posterior.to_dict())))


@pytest.mark.parametrize(
    "change",
    [
        lambda p: p.update(schema="akm-fg/posterior/2"),
        lambda p: p.update(kind="sliding"),
        lambda p: p.pop("states"),
        lambda p: p.update(more=1),
        lambda p: p["joint"].update(axis=[0, 1]),
        lambda p: p["joint"]["cov"].pop(),
        lambda p: p["states"]["mean"].append("x"),
        lambda p: p["fit"].pop("parametric"),
        lambda p: p["kind_probability"].update(revolute=1.5),
        lambda p: p["evidence"]["rigid"].pop("log_noise"),
    ],
)
def test_what_is_no_posterior_does_not_fit(validator, door_model, change) -> None:
    fields = json.loads(json.dumps(door_model.parts[0].posterior.to_dict()))
    change(fields)
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(fields)
