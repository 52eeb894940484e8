"""Models of transformers and diffusers from a folder on this disk, whole or refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from akm_fg.errors import InputError

BROKEN = (OSError, ValueError, RuntimeError, KeyError, TypeError, EOFError)
"""What loading raises where files are absent, damaged, or of another model."""


def pretrained(model: Any, folder: Path, what: str, device: str, **options: Any) -> Any:
    """A model with all its weights from a folder, for inference; nothing is downloaded.

    Args:
        model: a class with `from_pretrained` as transformers and diffusers have it.
        folder: of `config.json` and weights.
        what: should be there, for messages.
        device: of torch.
        options: of the class's own `from_pretrained`.

    Raises:
        InputError: files are absent or damaged, weights are missing, or no such device.
    """
    from transformers.utils import logging

    logging.disable_progress_bar()  # only the command line prints
    try:
        loaded, report = model.from_pretrained(
            folder, local_files_only=True, output_loading_info=True, **options
        )
    except BROKEN as error:
        raise InputError(folder, f"cannot be loaded ({first_line(error)})", what) from error
    missing = sorted(report.get("missing_keys", ()))
    if missing:
        # They would be drawn at random, and the answers with them.
        problem = f"lacks {len(missing)} weights, such as {missing[0]}"
        raise InputError(folder, problem, what)
    try:
        return loaded.eval().to(device)
    except RuntimeError as error:
        raise InputError("device", f"{device!r}: {first_line(error)}", "a device that works") from (
            error
        )


def first_line(error: Exception) -> str:
    """Of a message that may be long."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
