"""The console script `akm-fg`."""

from __future__ import annotations

import errno
import logging
import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType
from typing import Any

from akm_fg import __version__
from akm_fg.cli.exit_codes import BAD_INPUT, DONE, INTERRUPTED, READER_LEFT


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit code says how it went.

    0: done; 1: ran, goal not reached or kind undecided; 2: bad input; 130: interrupted.
    """
    from akm_fg.cli.console.lines import complain, leave_broken_pipe, prepare_streams
    from akm_fg.errors import AkmError

    prepare_streams()
    words = sys.argv[1:] if argv is None else list(argv)
    try:
        code = _run(words)
        sys.stdout.flush()
        return code
    except AkmError as error:
        complain(str(error))
        return BAD_INPUT
    except KeyboardInterrupt:
        complain("interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        leave_broken_pipe()
        return READER_LEFT
    except OSError as error:
        if error.filename is not None or error.errno not in _WRITE_ERRORS:
            return _unforeseen(words, error)
        leave_broken_pipe()  # what could not be written would be tried again at exit
        complain(f"standard output: cannot be written ({error.strerror})")
        return BAD_INPUT
    except Exception as error:
        return _unforeseen(words, error)


def _unforeseen(words: Sequence[str], error: Exception) -> int:
    """One line of an error that nobody thought of; who wants to see where, asks for all of the log.

    Raises:
        Exception: itself, with AKM_FG_LOG=DEBUG.
    """
    from akm_fg.cli.console.lines import complain

    if os.environ.get(_LOG, "").upper() == "DEBUG":
        raise error
    cause = " ".join(f"{type(error).__name__}: {error}".split())[:_CAUSE_LENGTH]
    complain(f"{' '.join(words[:1])}: ended by an error ({cause}); {_LOG}=DEBUG shows where")
    return BAD_INPUT


def _run(argv: list[str]) -> int:
    if argv == ["--version"]:
        print(f"akm-fg {__version__}")
        return DONE
    from akm_fg.errors import InputError

    _set_up_log()
    name, arguments = parsed(argv)
    seed = getattr(arguments, "seed", 0)
    if seed < 0:
        raise InputError("--seed", f"is {seed}", "a whole number from 0 on")
    code: int = getattr(_module(name), name)(arguments)
    return code


def parsed(argv: Sequence[str]) -> tuple[str, Any]:
    """A command's name and arguments.

    Raises:
        SystemExit: there is no such command or flag, which has been said; or help was asked for.
    """
    import tyro

    taken_by = {getattr(_module(name), f"{name.title()}Arguments"): name for name in _COMMANDS}
    arguments = tyro.extras.subcommand_cli_from_dict(
        {name: kind for kind, name in taken_by.items()},
        prog="akm-fg",
        description=_DESCRIPTION,
        args=argv,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
    )
    return taken_by[type(arguments)], arguments


def _module(name: str) -> ModuleType:
    return import_module(f"akm_fg.cli.{_COMMANDS[name]}")


class _PrintableLines(logging.Formatter):
    """Names of files in messages cannot write to the terminal."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        from akm_fg.report.wording import printable

        return printable(super().formatMessage(record))


def _set_up_log() -> None:
    from akm_fg.errors import InputError

    level = os.environ.get(_LOG, "WARNING").upper()
    if level not in logging.getLevelNamesMapping():
        raise InputError(_LOG, f"is {level!r}", "DEBUG, INFO, WARNING or ERROR")
    handler = logging.StreamHandler()
    handler.setFormatter(_PrintableLines("%(levelname)s %(message)s"))
    logging.basicConfig(level=level, handlers=[handler])
    if level == "WARNING":  # progress of what takes long is told unless somebody wants less
        logging.getLogger("akm_fg.progress").setLevel(logging.INFO)
    if level != "DEBUG":
        # Numbers that are not finite are told where they come out (docs/conventions.md).
        warnings.simplefilter("ignore", RuntimeWarning)


# Command -> its module in `akm_fg.cli`, with a function of its name and `NameArguments`.
_COMMANDS = {
    "demo": "demo",
    "explore": "exploring.explore",
    "run": "running.run",
    "fit": "fit",
    "check": "looking.check",
    "score": "looking.score",
    "objects": "objects",
    "convert": "recordings.convert",
    "calibrate": "calibrate",
    "relocalize": "models.relocalize",
    "export": "models.export",
    "view": "models.view",
    "doctor": "doctor",
}
_LOG = "AKM_FG_LOG"
_CAUSE_LENGTH = 300  # characters of an error's own words
_WRITE_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)
_DESCRIPTION = """Joints of unseen articulated objects from RGB-D, with honest covariances.

Example: akm-fg fit recordings/* tracks.npz door.log --json posteriors.jsonl

Exit codes: 0 done; 1 ran, but the goal was not reached or a kind is undecided; 2 bad input (the
others are done); 130 interrupted (what was done is kept). akm-fg --version says which this is.

Completion: eval "$(akm-fg --tyro-print-completion bash)" (or zsh, tcsh).
"""


if __name__ == "__main__":
    sys.exit(main())
