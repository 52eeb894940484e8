"""Stages by name, one file each: the file's name is the backend's, and it is all that one adds.

A file in `trackers/`, `segmenters/` or `features/` has a function `make(settings)` that returns the
stage (`akm_fg.interfaces`); what it needs to import, and weights, are loaded there and not before.
Its own tuning is a frozen dataclass whose defaults the table `[stages.own.NAME]` of a `--config`
file changes:

    def make(settings: BackendSettings) -> PointTracker:
        return CoTracker(settings.own(CoTrackerConfig()))
"""
