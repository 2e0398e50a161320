"""The command ``chona``: words in, exit code out, and one line on stderr when something is wrong.

Exit codes: 0 done, 1 failed or cancelled, 2 bad arguments or input.  ``chona info`` and ``--help`` start without torch.
"""

from __future__ import annotations

import contextlib
import shlex
import sys
import traceback
from collections.abc import Sequence
from itertools import pairwise

from chona_model import commands, farm_commands, journal, process, study_commands
from chona_model.arguments import UsageError, glue_frames
from chona_model.command_line import make_parser
from chona_model.launch import read_launch
from chona_model.memory import was_short_of_memory
from chona_model.progress import Cancelled, Progress

FAILED, BAD_INPUT = 1, 2
TOGETHER = (commands.train_command, study_commands.add_command)
"""What several processes can do together."""

COMMANDS = {
    "train": commands.train_command,
    "evaluate": commands.evaluate_command,
    "bake": commands.bake_command,
    "trade": commands.trade_command,
    "estimate": commands.estimate_command,
    "reproduce": study_commands.reproduce_command,
    "add": study_commands.add_command,
    "farm": farm_commands.farm_command,
    "stand-in": commands.stand_in_command,
    "serve": commands.serve_command,
    "jobs": commands.jobs_command,
    "info": commands.info_command,
    "check-data": commands.check_data_command,
    "doctor": commands.doctor_command,
    "demo": commands.demo_command,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    process.tune()
    words = glue_frames(sys.argv[1:] if argv is None else argv)
    progress = Progress(_mode(words))
    progress.quiet = read_launch().rank > 0
    progress.job = words[0] if words and not words[0].startswith("-") else "chona"
    try:
        # Libraries print where they like; stdout belongs to the events.
        with contextlib.redirect_stdout(sys.stderr) if progress.mode == "json" else contextlib.nullcontext():
            return _run(words, progress)
    except BrokenPipeError:
        # Nobody reads any more: keep Python from failing once more when it flushes stdout at exit.
        sys.stdout = None
        return FAILED
    finally:
        if progress.record is not None:
            progress.record.close()


def _run(words: list[str], progress: Progress) -> int:
    try:
        try:
            arguments = make_parser(COMMANDS).parse_args(words)
        except SystemExit as end:  # --help and --version
            return int(end.code or 0)
        if read_launch().size > 1 and arguments.run not in TOGETHER:
            raise UsageError(
                f"torchrun has started {read_launch().size} processes of '{words[0]}', which would all do the same; "
                "only train and add work together: start the others without torchrun"
            )
        if getattr(arguments, "detach", False):
            from chona_model.detached import start_detached

            return start_detached(words, arguments, progress)
        with progress.cancel if hasattr(arguments, "progress") else contextlib.nullcontext():
            if getattr(arguments, "until_closed", False):
                process.end_with_parent(progress.cancel.request)
            if getattr(arguments, "progress_file", None) is not None and not progress.quiet:
                from chona_model.formats.job_file import JobFile

                progress.record = JobFile(arguments.progress_file, words, progress.cancel.request)
            if hasattr(arguments, "progress"):
                journal.note_start(words)
            code = arguments.run(arguments, progress)
            if hasattr(arguments, "progress"):
                journal.note_end(words, code)
            return code
    except (Cancelled, KeyboardInterrupt):
        if progress.ended is None:
            progress.cancelled()
        return FAILED
    except BrokenPipeError:
        raise
    except Exception as error:
        if "--debug" in words:
            traceback.print_exc()
        if was_short_of_memory(error):
            traceback.clear_frames(error.__traceback__)  # what they hold is wanted for the message
        code = BAD_INPUT if _is_house_error(error) else FAILED
        journal.note(f"fails with {code}: {shlex.join(words)}", error)
        progress.error(str(error) if code == BAD_INPUT else _describe(error, words), code)
        return code


def _mode(words: Sequence[str]) -> str:
    """The progress mode before anything is parsed, so that parsing errors are reported in it too."""
    asked = "--progress=json" in words or ("--progress", "json") in pairwise(words)
    return "json" if asked or any(word.startswith("--progress-file") for word in words) else "terminal"


def _is_house_error(error: Exception) -> bool:
    """Whether an exception is one of this package's own that speak of the user's input."""
    return isinstance(error, ValueError) and type(error).__module__.partition(".")[0] == "chona_model"


MEMORY_REMEDIES = {
    "bake": "frames that are there are whole and kept: bake with --max-memory, a faster --preset or a smaller picture",
    "train": "the last checkpoint is kept: train with a smaller --image-scale",
    "add": "the last checkpoint is kept: add with a smaller --image-scale",
}


def _describe(error: Exception, words: Sequence[str]) -> str:
    if was_short_of_memory(error):
        told = " ".join(str(error).split())[:200]
        remedy = MEMORY_REMEDIES.get(words[0], "use smaller images")
        return f"out of memory{f' ({told})' if told else ''}; {remedy}, or close other programs"
    if type(error).__module__.partition(".")[0] == "chona_model":
        return str(error)  # its own words say all there is to say
    text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    if isinstance(error, ImportError):
        text += "; 'chona doctor' says what to install"
    return text if "--debug" in words else f"{text} (--debug shows where)"
