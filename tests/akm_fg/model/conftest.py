"""One fitted recording a kind, and its model."""

from __future__ import annotations

import pytest

from akm_fg.model.build import FittedRecording, build_model
from akm_fg.pipeline import fit_recording


@pytest.fixture(scope="session")
def fitted_door(door):
    return FittedRecording.of(door.recording, fit_recording(door.recording))


@pytest.fixture(scope="session")
def door_model(fitted_door):
    return build_model(fitted_door)


@pytest.fixture(scope="session")
def drawer_model(drawer):
    return build_model(FittedRecording.of(drawer.recording, fit_recording(drawer.recording)))
