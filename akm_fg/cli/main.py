"""The console script `akm-fg`."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Sequence

from akm_fg.cli.exit_codes import BAD_INPUT, INTERRUPTED


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit code says how it went.

    0: done; 1: ran, goal not reached; 2: bad input; 130: interrupted.
    """
    import tyro

    from akm_fg.cli.calibrate import CalibrateArguments, calibrate
    from akm_fg.cli.demo import DemoArguments, demo
    from akm_fg.cli.doctor import DoctorArguments, doctor
    from akm_fg.cli.fit import FitArguments, fit
    from akm_fg.cli.objects import ObjectsArguments, objects
    from akm_fg.errors import AkmError

    logging.basicConfig(
        level=os.environ.get("AKM_FG_LOG", "WARNING").upper(), format="%(levelname)s %(message)s"
    )
    arguments = tyro.extras.subcommand_cli_from_dict(
        {
            "demo": DemoArguments,
            "fit": FitArguments,
            "objects": ObjectsArguments,
            "calibrate": CalibrateArguments,
            "doctor": DoctorArguments,
        },
        prog="akm-fg",
        description=_DESCRIPTION,
        args=None if argv is None else list(argv),
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
    )
    try:
        match arguments:
            case DemoArguments():
                return demo(arguments)
            case FitArguments():
                return fit(arguments)
            case ObjectsArguments():
                return objects(arguments)
            case CalibrateArguments():
                return calibrate(arguments)
            case _:
                return doctor(arguments)
    except AkmError as error:
        print(f"akm-fg: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("akm-fg: interrupted", file=sys.stderr)
        return INTERRUPTED


_DESCRIPTION = """Joints of unseen articulated objects from RGB-D, with honest covariances.

Example: akm-fg fit recordings/* tracks.npz door.log --json posteriors.jsonl
"""


if __name__ == "__main__":
    sys.exit(main())
