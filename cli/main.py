"""The `lightstage` command: the parser, the errors and the exit codes.

Exit codes: 0 done, 1 the work failed, 2 the request was wrong. An error is one sentence on stderr; a traceback
only with --debug.
"""

import argparse
import contextlib
import errno
import gc
import os
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

from lightstage import __version__
from lightstage.api.errors import (
    DamagedChunkError,
    DamagedGroupError,
    LightstageError,
    RequestError,
    WorkError,
)
from lightstage.cli.show import Screen, written
from lightstage.compiled import folder, offer

# a command makes the functions of a hundred modules; looking through them for circles took a tenth of its time
gc.set_threshold(20_000)
# pydantic looks through all that is installed for plugins of its own, an eighth of a short command's time
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")

COMMANDS = {
    "run": "run",
    "normals": "run",
    "performance": "run",
    "import": "sessions",
    "sessions": "sessions",
    "calibration": "sessions",
    "calibrate": "calibrate",
    "status": "look",
    "why": "look",
    "graph": "look",
    "path": "look",
    "verify": "keep",
    "gc": "keep",
    "upgrade": "keep",
    "export": "export",
    "demo": "demo",
    "sequence": "sequence",
    "alignment": "alignment",
    "skin": "skin",
    "shape": "shape",
    "material": "material",
    "relight": "relight",
    "stimuli": "stimuli",
}
"""Every command, and the module of this folder that has it, which is imported for it alone."""


class _Parser(argparse.ArgumentParser):
    """argparse, with one sentence and the nearest name instead of the whole usage."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False)

    def _print_message(self, message: str, file: Any = None) -> None:
        # argparse keeps silent where its help cannot be written
        with written():
            print(message, end="", file=file)

    def error(self, message: str) -> NoReturn:
        command = self.prog.removeprefix("lightstage").strip()
        wrong = re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message)
        if wrong:
            from lightstage.store.document import nearest

            options = re.findall(r"[\w.-]+", wrong[2])
            message = f"'{wrong[1]}' is not known{nearest(wrong[1], options)}"
        lacking = re.fullmatch(r"argument (--[\w-]+): expected one argument", message)
        if lacking:
            message += f", or {lacking[1]}=-... where it begins with a minus"
        raise RequestError(
            f"{command + ': ' if command else ''}{message} (`{self.prog} --help` lists what there is)"
        )


def build_parser(words: Sequence[str] = ()) -> argparse.ArgumentParser:
    """The parser of the command that is named first among the words, or of all commands where none is."""
    parser = _Parser(
        prog="lightstage", description="Surface normals and reflectance from a multispectral light stage."
    )
    parser.add_argument("--version", action="version", version=f"lightstage {__version__}")
    parser.add_argument(
        "--store",
        default=os.environ.get("LIGHTSTAGE_STORE", "data"),
        metavar="DIR",
        help="the folder that holds everything (default: $LIGHTSTAGE_STORE, or data)",
    )
    _common(parser, default=False)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=_Parser)
    family = COMMANDS.get(_first_command(words))
    for module in dict.fromkeys(COMMANDS.values()) if family is None else [family]:
        import_module(f"lightstage.cli.{module}").configure(commands)
    for command in commands.choices.values():
        _common(command, default=argparse.SUPPRESS)
        for action in command._actions:
            if isinstance(action, argparse._SubParsersAction):
                for inner in action.choices.values():
                    _common(inner, default=argparse.SUPPRESS)
    return parser


def _first_command(words: Sequence[str]) -> str:
    """The first word that is no option; empty where help is asked for before it, which is about all commands."""
    rest = iter(words)
    for word in rest:
        if word == "--store":
            next(rest, None)
        elif word in ("-h", "--help"):
            return ""
        elif not word.startswith("-"):
            return word
    return ""


def _common(parser: argparse.ArgumentParser, *, default: object) -> None:
    parser.add_argument("--json", action="store_true", default=default, help="one JSON document on stdout")
    parser.add_argument("--debug", action="store_true", default=default, help="show the traceback of an error")
    if default is argparse.SUPPRESS:  # behind the command it is understood, too
        parser.add_argument("--store", default=default, metavar="DIR", help=argparse.SUPPRESS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    screen = Screen(as_json="--json" in words)
    try:
        code = _command(words, screen)
        if "numba" in sys.modules and folder() is None:
            screen.warn(
                "compiled code is not kept, because neither the user's cache folder nor the store can be written, "
                "and every command compiles anew; set XDG_CACHE_HOME to a folder that can be written"
            )
        screen.flush()
        return code
    except LightstageError as error:
        return _failed(error, error.exit_code, screen, words)
    except KeyboardInterrupt:
        stop = RequestError("stopped; what was finished is kept, and the next run goes on from there")
        return _failed(stop, 130, screen, words)
    except BrokenPipeError:
        screen.close()
        return 1
    except OSError as error:
        return _failed(_as_sentence(error), 1, screen, words)
    except MemoryError as error:
        lacking = WorkError(
            f"there is not enough memory for this ({error or 'none left'}); what was finished is kept"
        )
        return _failed(lacking, 1, screen, words)
    except Exception as error:
        if "--debug" in words:
            raise
        if isinstance(error, ImportError) and "failed to map segment" in str(error):
            lacking = WorkError(f"there is not enough memory to load {error.name or 'a library'} (see `ulimit -v`)")
            return _failed(lacking, 1, screen, words)
        name = type(error).__name__
        message = f"unexpected {name}: {error}; run again with --debug and report what it shows"
        return _failed(RequestError(message), 1, screen, words)


def _command(words: Sequence[str], screen: Screen) -> int:
    for word in words:
        if re.fullmatch(r"--[\w-]+=--", word):  # of which argparse makes an empty list
            raise RequestError(f"{word}: '--' is no value")
    try:
        options, strange = build_parser(words).parse_known_args(words)
    except SystemExit as done:  # --help and --version have said what was asked for
        return int(done.code or 0)
    if strange:
        raise RequestError(_not_understood(strange, options))
    if options.command is None:
        if screen.as_json:
            raise RequestError("a command is missing (`lightstage --help` lists them)")
        build_parser().print_help()
        return 2
    offer(options.store)
    try:
        return int(options.handler(options, screen))
    except (DamagedChunkError, DamagedGroupError) as damage:
        from lightstage.cli.keep import set_aside

        set_aside(damage, options, screen)
        # begun again; what was computed before is there
        return int(options.handler(options, screen))


def _not_understood(strange: Sequence[str], options: argparse.Namespace) -> str:
    command = f" {options.command}" if options.command is not None else ""
    hint = (
        "a session is named by --session, and `" if "session" in options and not strange[0].startswith("-") else "`"
    )
    where = f"{command.strip()}: " if command else ""
    return f"{where}'{' '.join(strange)}' is not understood ({hint}lightstage{command} --help` lists what there is)"


_REMEDIES = {
    errno.ENOSPC: "; free some space and run again",
    errno.EDQUOT: "; free some space and run again",
    errno.EFBIG: "; the file system, or `ulimit -f`, allows no file of that size",
    errno.EMFILE: "; raise the limit with `ulimit -n`, and run again",
    errno.ENFILE: "; close other programs, and run again",
    errno.ELOOP: "; a link there leads back to itself",
}


def _as_sentence(error: OSError) -> WorkError:
    """What the operating system refused: which file, why, and what helps where that is known."""
    try:
        os.getcwd()
    except OSError:
        return WorkError("the working folder is gone, or may not be entered; change to one that is there")
    files = " to ".join(
        os.fsdecode(name) for name in (error.filename, error.filename2) if isinstance(name, str | bytes)
    )
    reason = error.strerror or str(error) or type(error).__name__
    return WorkError(f"{files + ': ' if files else ''}{reason}{_REMEDIES.get(error.errno or 0, '')}")


def _failed(error: LightstageError, code: int, screen: Screen, words: Sequence[str]) -> int:
    if "--debug" in words:
        import traceback

        traceback.print_exc()
    # a name of thousands of characters is nothing to read
    sentence = re.sub(r"\S{500,}", lambda word: f"{word[0][:100]}...{word[0][-20:]}", str(error))
    with contextlib.suppress(OSError):
        print(f"lightstage: {sentence}", file=sys.stderr)
    try:
        screen.document({"error": sentence, "exit_code": code})
        screen.flush()
    except (OSError, WorkError):
        screen.close()
    return code


if __name__ == "__main__":
    sys.exit(main())
